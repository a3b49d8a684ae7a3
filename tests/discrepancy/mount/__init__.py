"""The telescope mount: geometry, terms, files, search."""
