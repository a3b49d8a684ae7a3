"""`bench discover` and `bench design`: the request, one search for each set of data, its record on disk, and advice.

`request` reads the command line, `batch` searches set after set and proposes the next measurement, `schema` and `store`
keep the results, `design` answers before anything is fitted, `page` shows one verdict in words and drawings.
"""
