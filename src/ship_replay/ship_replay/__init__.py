"""Bags: simulate, replay, play, record, evaluate, import."""
