"""Glossary of the suite: frames, rotations, errors, names and units.

Every module of every package obeys this page.

Frames
    All frames are right-handed. Every device carries a frame **(forward, up, right)**.

    ====  ==========================  =====================================================
    name  axes                        remarks
    ====  ==========================  =====================================================
    n     North, Up, East             horizon frame; Up is the ellipsoid normal at the ship
    d     bow, up, starboard          deck frame, which the ship defines as its reference
    s     boresight, up, right        star sensor
    ENU   East, North, Up             ROS parent frame, met only at the ROS edge
    FLU   forward, left, up           ROS device frame, met only at the ROS edge
    ====  ==========================  =====================================================

Rotations
    ``rotation_nd`` (shape (3, 3)) turns a vector given in d into the same vector in n:
    ``v_n = rotation_nd @ v_d``. In words: "n from d". Device orientation in a parent frame is three
    angles (:mod:`ship_geometry.frames`): azimuth clockwise seen from above, elevation up, roll right side
    down. For the deck in the horizon these are heading K, pitch (bow up) and roll (starboard down).

Error of an attitude
    The small rotation vector delta in the **parent** frame with
    ``rotation_true = exp(delta) @ rotation_estimate``; its covariance is ``E[delta delta^T]`` in rad².

Names and units
    Radians, metres, seconds; anything else says so: ``_deg``, ``_arcsec``, ``_ns``. Time is integer
    nanoseconds of POSIX UTC, taken from the data. Quaternions are x, y, z, w and exist only at the ROS edge.
"""
