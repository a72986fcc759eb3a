"""Persistent files: documents saved for a node's next start, figures and pages.

The lowest room of the package: it imports no other one, and no ROS.
"""
