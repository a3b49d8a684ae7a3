"""What the page of a study draws by itself, on demand: its numbers as one compact block, and the scripts that draw."""
