"""A study in the formats of other tools: written for their readers, and read from what they publish. A file a format.

`studies` reads what is to be written, `course` gives the improvements of a run and their cost, `targets` the gap of a
level above a minimum, `folders` makes an output appear whole or not at all, `published` makes a study of what was read.
"""
