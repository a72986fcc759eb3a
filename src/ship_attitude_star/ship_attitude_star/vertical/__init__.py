"""The vertical under way: how gravity differs from the ellipsoid's normal at the ship's place, and how far she sailed.

Knows the ship's place (room ``sky``) and what messages say (room ``measurements``), no star and no filter.
"""
