"""A GPM2002 with physics of its own: members, statics, plan, hidden effects, noise, and the table that it leaves."""
