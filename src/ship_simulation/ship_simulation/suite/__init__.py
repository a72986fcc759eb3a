"""The suite file that belongs to a scenario: the parameters that the nodes would be given on that ship."""
