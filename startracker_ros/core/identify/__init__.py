"""Which star is which: pattern database, search, verification."""
