"""What every room stands on: names with checked options, and compilation. Knows no problem and no optimiser."""
