"""A study as files: figures, tables and one page that is read offline."""
