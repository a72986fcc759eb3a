"""Files for people that outlast a run: what a node saves for its next start, and figures."""
