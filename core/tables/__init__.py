"""Tables of readings in files: CSV and Excel, units of columns, cells without a number, marks of rows."""
