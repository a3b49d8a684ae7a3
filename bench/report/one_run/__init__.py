"""One run in a terminal: `found` looks it up, `story` describes it, `curve` draws it, `again` repeats it."""
