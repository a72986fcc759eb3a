"""Persistent files: documents saved for a node's next start, figures and pages.

The folder imports neither other folders of the package nor ROS.
"""
