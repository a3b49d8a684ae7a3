"""A study in the formats of others: written for their readers, and read from what they publish. A file a format.

`studies` reads what is to be written, `course` says what a run had reached at which cost, `targets` how levels stand
above a minimum, `folders` lets an output appear whole or not at all, `published` makes a study of what was read.
"""
