"""The common parts of all pages and figures: style, colours, Markdown tables."""
