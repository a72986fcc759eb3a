"""Frame of all HTML pages, figures and printed tables, of reports and studies."""
