"""What people see of a result: tables, plots, one self-contained HTML page. Numbers come from elsewhere."""
