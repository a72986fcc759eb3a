"""Two recordings side by side: one page with their differences."""
