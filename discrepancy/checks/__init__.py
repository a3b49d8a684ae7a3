"""What is checked of measured data, of every machine, before anything is fitted.

`validated` is the whole of it. `entered` looks at what any table of readings has (valid, split, poses and visits,
time), `copies` at rows that come again, `wild` at numbers far from what the model can give, with the factor that would
cure, `unused` at what is stated and never read. `calibench.discrepancy.model.measured.complete` leaves out rows with
missing cells.
"""
