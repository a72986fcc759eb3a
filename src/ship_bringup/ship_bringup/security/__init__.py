"""DDS security of a suite: permissions of its programs, policies with these permissions, and the ship's keystore.

The folder imports no other folder of this package and creates no node.
"""
