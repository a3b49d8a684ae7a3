"""One run told in a terminal: `found` looks it up, `story` tells it, `curve` draws it, `again` repeats it."""
