"""Files that outlast a run: what a node saves for its next start, and figures and pages for people.

The lowest room of the package: it imports no other, and no ROS.
"""
