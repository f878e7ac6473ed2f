"""What people run: command line, doctor, report, reprocess, trend, live, demos."""
