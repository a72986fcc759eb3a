"""Files that outlast a run: documents saved for a node's next start, figures and pages for people.

The lowest room of the package: it imports no other one, and no ROS.
"""
