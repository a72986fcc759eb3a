"""Persistent files: documents saved for a node's next start, figures and pages.

The folder imports no other folder of the package, and no ROS.
"""
