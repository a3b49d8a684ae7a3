"""`bench discover` and `bench design`: what is asked, a search a set of data, its record on disk, and the advice on it.

`request` reads the command line, `batch` searches set after set, `record` and `store` keep what came of it, `advice`
says what to measure next, `design` answers before anything is fitted, `page` draws and words one verdict.
"""
