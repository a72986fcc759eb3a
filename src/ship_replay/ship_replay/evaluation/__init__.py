"""What a run was worth: errors against the truth, innovations, shares of status, as tables and figures."""
