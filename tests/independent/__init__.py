"""Simulators with physics of their own, for cases that the catalogue did not make."""
