"""Before any fit: which effects a plan or data can show, which look alike, and which readings to take next."""
