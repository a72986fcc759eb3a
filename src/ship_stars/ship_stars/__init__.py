"""Stars for both estimators: sky model, camera, identification, attitude from the stars of an exposure.

``sky`` has the apparent directions of catalogue stars, ``camera`` the conversion between pixels and directions,
``attitude_from_stars`` the way from an exposure to an attitude. ``attitude_samples`` has plain data classes. Only
``messages``, which reads ROS messages, imports the node package.
"""
