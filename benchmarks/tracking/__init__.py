"""How fast the catalogue is, and how often a history sees a change where there is none."""
