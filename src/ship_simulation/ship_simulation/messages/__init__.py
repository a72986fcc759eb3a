"""Simulated samples as messages on topics. The room knows message types and units; it draws nothing."""
