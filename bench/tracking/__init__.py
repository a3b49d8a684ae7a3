"""All studies below a folder: the catalogue, SQL over their tables, histories, archives."""
