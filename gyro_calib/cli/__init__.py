"""The command line: one module per command; what computes is imported when a command runs, so that help comes at once."""
