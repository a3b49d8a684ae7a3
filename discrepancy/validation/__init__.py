"""Validation: residuals before and after, on fitted rows and on held-out poses, relative to the noise floor."""
