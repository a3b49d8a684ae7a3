"""What all pages and figures share: style, colours, Markdown tables."""
