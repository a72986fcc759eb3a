"""State of the sources of a suite: decisions, reports on inputs, reasons why a source is OUT."""
