"""What a plan or data could tell before any fit: which effects are seen, which look alike, what to read next."""
