"""A study in the formats of other tools: written for their readers, and read from what they publish. A file a format.

`studies` reads what is to be written, with the improvements of each run and their cost; `published` makes a study of
what was read.
"""
