"""DDS security of a suite: permissions of each of its programs, the policies that state them, and the ship's keystore.

The folder may import the adapters and ``ship_bags``. It imports no other folder of this package and creates no node.
"""
