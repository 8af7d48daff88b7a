"""One module per study, each with a constant ``STUDY``."""
