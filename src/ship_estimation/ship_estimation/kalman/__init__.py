"""Kalman filter: state vector, steps, Rauch-Tung-Striebel smoother, unobservable combinations."""
