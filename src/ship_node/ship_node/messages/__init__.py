"""Conversion between messages and numbers: checks of fields, blocks and batches of messages, messages of every node."""
