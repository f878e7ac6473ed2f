"""One module per executable: declare, convert, call the core, publish."""
