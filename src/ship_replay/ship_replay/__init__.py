"""The suite offline: replay, verify, evaluate, calibrate, check before the voyage, try in many runs."""
