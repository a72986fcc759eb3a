"""Server of the topics for Foxglove, and what it has in common with the page's: allowed hosts, bounded connections."""
