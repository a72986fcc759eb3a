"""Glossary of the suite: frames, rotations, terms, names and units.

Every module of every package obeys this page. This package knows numpy, ERFA and the tables of the Earth's rotation; it
imports no other package of the suite.

Frames
    All frames are right-handed. Whatever points carries the axes **(forward, up, right)**: a vector (x, y, z) in it is
    x forward, y up and z to the right. "Owner" is who decides where the axes lie.

    ====  =======================  ===========================  ====================================================
    name  axes                     owner                        what it is
    ====  =======================  ===========================  ====================================================
    n     North, Up, East          WGS 84 and the ship's place  horizon; Up is the ellipsoid normal at the ship
    d     bow, up, starboard       the ship                     deck: the levelled plate that the ship refers all to
    i     forward, up, right       the INS's maker              case of the INS; ``ins.installation`` turns it into d
    s     boresight, up, right     the sensor's maker           star sensor; up and right are those of its picture
    v     forward, up, right       the device                   a device aboard where the code serves several kinds of
                                                                it: a star sensor or a reference
    r     forward, up, right       the device                   reference: another attitude system aboard
    b     forward, up, right       the body                     body where the code serves several: a drone (nose, up,
                                                                right); sensor or deck where stars are fitted
    f     bow, up, starboard       the hull                     foot of the theodolite: d as the hull, bent since it
                                                                was surveyed, carries it there
    x     forward, up, right       the theodolite               the part of the mount that turns in azimuth
    m     optical axis, up, right  the theodolite               main frame: the main tube
    t     optical axis, up, right  the theodolite               calibration telescope beside the main tube
    c     x, y, z of the ICRS      the IAU                      celestial frame (ICRS): x to right ascension 0, z to
                                                                the celestial north pole
    e     x, y, z of ECEF          WGS 84                       Earth: x to Greenwich on the equator, z to the pole
    ENU   East, North, Up          ROS (REP-103)                parent frame of messages, met only at the ROS edge
    FLU   forward, left, up        ROS (REP-103)                device frame of messages, met only at the ROS edge
    NED   North, East, Down        the INS's maker              as ENU, of an INS with ``convention: ned_frd``
    FRD   forward, right, down     the INS's maker              as FLU, of an INS with ``convention: ned_frd``
    ====  =======================  ===========================  ====================================================

Rotations
    ``rotation_nd`` (shape (3, 3)) turns a vector given in d into the same vector in n:
    ``v_n = rotation_nd @ v_d``. In words: "n from d". The orientation of a device in its parent frame is three
    angles (:mod:`ship_geometry.frames`): **azimuth** clockwise seen from above, from the parent's forward axis;
    **elevation** up; **roll** right side down. Of the deck in the horizon these are **heading**, **pitch** (bow up) and
    **roll** (starboard down).

    A **rotation vector** is the axis of a turn times its angle in radians. ``exp`` makes a matrix of it, ``log`` the
    vector of a matrix.

Error of an attitude
    The small rotation vector delta in the **parent** frame with
    ``rotation_true = exp(delta) @ rotation_estimate``; its covariance is ``E[delta delta^T]`` in rad².

Names and units
    Radians, metres, seconds; anything else says so: ``_deg``, ``_arcsec``, ``_ns``, ``_m``, ``_hpa``. Time is integer
    nanoseconds of POSIX UTC, taken from the data. Quaternions are x, y, z, w and exist only at the ROS edge. ``sigma``
    is a standard deviation, ``covariance_n`` a covariance about the axes of n.

Terms of the sky
    Apparent direction
        Where a star is seen from the ship: its catalogue place after proper motion, parallax, aberration, the Earth's
        rotation and refraction.
    Aberration
        The shift of a star's direction by the observer's speed: 20″ by the Earth's way round the Sun, 0.3″ by its
        rotation, 0.01″ by the ship's own speed.
    Refraction
        How much higher the air lets a star (or a light) appear.
    UT1
        The time that the Earth's rotation shows. UT1 − UTC is measured by the IERS; a second of it is 15″.
    Deflection of the vertical
        The angle between gravity's zenith, on which an INS levels itself, and the ellipsoid normal Up.

Terms of the ship
    INS
        Inertial navigation system: attitude and rate at 100 Hz or so, always, with slow errors.
    Star sensor
        A camera that sees stars and gives their pixels (*observations*) or the attitude that it solved from them.
    Horizon attitude, inertial attitude
        Attitude of a sensor in n, and in c: azimuth, elevation, roll; or a quaternion against the ICRS.
    Solution
        The attitude that ``star_attitude`` finds from observations: of one sensor, or of the deck by all (*joint*).
    Reference
        Another attitude system aboard, which knows no stars.
    Installation
        How a device is bolted on: its three angles in d, and the small rotation by which these are wrong.
    Alignment
        What ``ship_attitude`` has learnt of all installations and clocks, as a message and as a file.
    Mask
        What stands on deck in the way of a sensor: a polygon over azimuth and elevation of d.
    Flexure
        The hull's bending between the INS and a sensor.
    Time offset tau
        A sample of a source is valid at its stamp + tau.

Terms of the theodolite
    Calibration
        What ``optical_axis`` has learnt of axis errors, focal length and deformation, as a message and as a file.
    Main optical axis
        The forward axis of m: where the theodolite points.
    Encoder
        The scale on an axis of the mount; the two read azimuth and elevation.
    Axis errors
        g and h, zero points of the encoders; c, collimation; I, tilt of the horizontal axis; beta_x and beta_y, tilt
        of the vertical axis towards the bow and towards starboard; flexure of the tube.
    Parallelism
        Three angles from the telescope's axis to the main axis, and what is wrong with them.
    Deformation
        The hull's bending between the INS and the theodolite's foot: f against d.
    Beacon, light
        A drone that knows its place by RTK, and the lamp on it that the telescope sees.
    Baseline
        The vector from the ship's antenna to a beacon's, in n.
    Lever
        The vector between two points of one rigid body: from an antenna to a lens, from an antenna to a light.
    Principal point
        Of the lens (N'): the point of the telescope at which lines of sight meet. Of the detector: where the axis
        of the lens falls.
    Sighting
        What one exposure of the telescope (or one row of a table) says about the axis.

Terms of estimation
    Measurement, residual, innovation
        What a device says; that minus what was predicted; the same as published, with its covariance and verdict.
    Gate
        How improbable a residual may be before its measurement is refused.
    Guard, witness
        What judges a source before its measurement is used; another source whose word it takes for that.
    Refusal, conflict
        A measurement that is not used, with its reason; a run of refusals of one source.
    Source, part, budget
        A named cause of error; its share of a covariance; all shares, whose sum is the covariance.
    Prior
        What is believed before a measurement, with its covariance.
    White, slow, constant
        An error that is new with each sample; one that fades over a correlation time (Gauss–Markov); one that stays.
    NEES, NIS
        Normalised error (innovation) squared: e^T P^-1 e. Where P is honest it is on average the number of
        components.
    Lag
        How late a measurement may come and still be applied at its own time.
    Stamp, log time, time of waiting
        When a measurement was valid; when a recorder wrote it; the steady time by which silence is judged.
    Exposure, streak
        The time over which a camera collects light; the trail that a star or a light draws meanwhile.

Terms of running
    Core, adapter, shell
        The arithmetic of a node, which knows no ROS; what turns messages into its structs and back; what runs it live.
    Suite file
        The parameter file of all nodes of a ship.
    Bag, black box
        A recording of topics; a recording of all that one node used and gave, which replays to the last bit.
    VALID, COASTING, DEGRADED, UNVERIFIED, INVALID
        Stars or lights stand behind a value; they did lately; they do not; stars that nothing confirms; no value, NaN.
"""
