"""Conversion between messages and numbers: checks of fields, batches of messages, messages of every node."""
