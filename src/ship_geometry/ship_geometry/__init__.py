"""Glossary of the suite: frames, rotations, terms, names and units.

Every module of every package follows this page. This package depends on numpy, ERFA and the tables of the Earth's
rotation, and on no other package of the suite.

Frames
    All frames are right-handed. A pointing device has the axes **(forward, up, right)**: a vector (x, y, z) in its
    frame is x forward, y up and z to the right. "Owner" is the party that defines the axes.

    ====  =======================  ===========================  ====================================================
    name  axes                     owner                        what it is
    ====  =======================  ===========================  ====================================================
    n     North, Up, East          WGS 84 and the ship's place  horizon; Up is the ellipsoid normal at the ship
    d     bow, up, starboard       the ship                     deck: the levelled reference plate of the ship
    i     forward, up, right       the INS's maker              case of the INS; ``ins.installation`` turns it into d
    s     boresight, up, right     the sensor's maker           star sensor; up and right are those of its picture
    v     forward, up, right       the device                   a device aboard where the code serves several kinds of
                                                                it: a star sensor or a reference
    r     forward, up, right       the device                   reference: another attitude system aboard
    b     forward, up, right       the body                     body where the code serves several kinds: a drone (nose,
                                                                up, right), or the sensor or deck of a fit to stars
    f     bow, up, starboard       the hull                     foot of the theodolite: d rotated by the bending of the
                                                                hull since the survey
    x     forward, up, right       the theodolite               the part of the mount that turns in azimuth
    m     optical axis, up, right  the theodolite               main frame: the main tube
    t     optical axis, up, right  the theodolite               calibration telescope, parallel to the main tube
    c     x, y, z of the ICRS      the IAU                      celestial frame (ICRS): x to right ascension 0, z to
                                                                the celestial north pole
    e     x, y, z of ECEF          WGS 84                       Earth: x to Greenwich on the equator, z to the pole
    ENU   East, North, Up          ROS (REP-103)                parent frame of messages, in message conversion only
    FLU   forward, left, up        ROS (REP-103)                device frame of messages, in message conversion only
    NED   North, East, Down        the INS's maker              as ENU, of an INS with ``convention: ned_frd``
    FRD   forward, right, down     the INS's maker              as FLU, of an INS with ``convention: ned_frd``
    ====  =======================  ===========================  ====================================================

Rotations
    ``rotation_nd`` (shape (3, 3)) transforms a vector given in d into the same vector in n:
    ``v_n = rotation_nd @ v_d``. In words: "n from d". The orientation of a device in its parent frame has three
    angles (:mod:`ship_geometry.frames`): **azimuth** clockwise seen from above, from the parent's forward axis;
    **elevation** up; **roll** right side down. For the deck in the horizon these are **heading**, **pitch** (bow up)
    and **roll** (starboard down).

    A **rotation vector** is the axis of a rotation times its angle in radians. ``exp`` gives its matrix, ``log`` the
    vector of a matrix.

Error of an attitude
    The small rotation vector delta in the **parent** frame with
    ``rotation_true = exp(delta) @ rotation_estimate``; its covariance is ``E[delta delta^T]`` in rad².

Names and units
    Radians, metres, seconds; other units are part of the name: ``_deg``, ``_arcsec``, ``_ns``, ``_m``, ``_hpa``. Time
    is integer nanoseconds of POSIX UTC, taken from the data. Quaternions are x, y, z, w and are used only in message
    conversion. ``sigma`` is a standard deviation, ``covariance_n`` a covariance about the axes of n.

Terms of the sky
    Catalogue place
        Right ascension and declination in the ICRS at the catalogue's epoch, with proper motion and parallax.
    Direction without air
        Direction of a star in n: its catalogue place after proper motion, parallax, light deflection, aberration and
        the Earth's rotation. In SOFA: the topocentric place.
    Apparent direction
        Direction of a star in n with refraction. In SOFA: the observed place; the apparent place of an almanac is
        geocentric and without air.
    Aberration
        The shift of a star's direction by the observer's velocity: 20″ by the Earth's orbit (annual), 0.3″ by its
        rotation (diurnal), 0.01″ by the ship's own velocity.
    Refraction
        Angle by which the air raises the apparent direction of a star (or a light).
    Earth orientation parameters (EOP)
        UT1 − UTC and polar motion, measured and predicted by the IERS.
    UT1
        Time scale defined by the Earth's rotation. The Earth rotates by 15″ in a second.
    Deflection of the vertical
        The angle from the ellipsoid normal Up to the astronomical zenith, that of gravity: xi northward, eta eastward.
        An INS levels itself by gravity.

Terms of the ship
    INS
        Inertial navigation system: attitude and rate at about 100 Hz without gaps, with correlated errors.
    Star sensor
        A camera that measures the pixels of stars (*observations*), or the attitude that it solves from them.
    Horizon attitude, inertial attitude
        Attitude of a sensor in n, and in c: azimuth, elevation, roll; or a quaternion against the ICRS.
    Solution
        The attitude that ``star_attitude`` computes from observations: of one sensor, or of the deck by all (*joint*).
    Reference
        Another attitude system aboard, without stars.
    Installation, mounting
        Orientation of a device on the deck: its three angles in d, and the small rotation of their error.
    Mounting shift
        A step of the installation of a device.
    Alignment
        The estimates of ``ship_attitude`` of all installations and clocks, as a message and as a file.
    Mask
        An obstruction on deck in the view of a sensor: a polygon over azimuth and elevation of d.
    Flexure
        The hull's bending between the INS and a sensor.
    Time offset tau
        A sample of a source is valid at its stamp + tau.

Terms of the theodolite
    Calibration
        The estimates of ``optical_axis`` of axis errors, focal length and deformation, as a message and as a file.
    Main optical axis
        The forward axis of m: the direction in which the theodolite points.
    Encoder
        The scale on an axis of the mount; the two encoders measure azimuth and elevation.
    Axis errors
        The terms of the pointing model, with the names of [W18]: g and h, zero points of the encoders; c, collimation;
        I, non-perpendicularity (tilt of the horizontal axis); beta_x and beta_y, tilt of the vertical axis towards the
        bow and towards starboard; flexure of the tube. Up to the sign these are TPOINT's IA, IE, CA, NPAE, AN, AW and
        TF (Wallace).
    Axis geometry
        The rotations from the ship's attitude through foot and mount to the main optical axis.
    Parallelism
        Three angles from the telescope's axis to the main axis, and their errors.
    Deformation
        The hull's bending between the INS and the theodolite's foot: f against d.
    Beacon, light
        A drone whose position is measured by RTK, and the lamp on it that the telescope observes.
    Baseline
        The vector from the ship's antenna to a beacon's, in n.
    Lever
        The vector between two points of one rigid body: from an antenna to a lens, from an antenna to a light.
    Principal point
        Of the lens (N'): the point of the telescope at which lines of sight meet. Of the detector: its intersection
        with the axis of the lens.
    Sighting
        The measurement of the axis by one exposure of the telescope (or one row of a table).

Terms of estimation
    Measurement, residual, innovation
        The data of a device; measured minus predicted; the residual as published, with its covariance and decision.
    Measurement decision
        A measurement is accepted or rejected; a rejection has a reason.
    Gate
        Threshold of the normalised innovation squared above which a measurement is rejected.
    Plausibility check, motion reference
        A check of a source before its measurement is used; another source that shows the motion for such a check.
    Rejection, conflict
        A measurement that is not used, with its reason; a series of rejections of one source.
    Error source, part, budget
        A named cause of error; its part of a covariance; the covariance by error source, whose sum is the covariance.
    Prior
        Estimate before a measurement, with its covariance.
    White, correlated, constant
        An error that is independent in each sample; one with a correlation time (Gauss–Markov); one that is constant.
    Inflated covariance
        A covariance to which that of a possible jump is added.
    NEES, NIS
        Normalised estimation error (innovation) squared: e^T P^-1 e (Bar-Shalom, Li, Kirubarajan 2001, §5.4). Its mean
        is the number of components if P is consistent.
    Lag
        Maximum delay of a measurement that is still applied at its own time.
    Stamp, log time, waiting time
        Time at which a measurement was valid; time at which a recorder wrote it; monotonic time for timeouts.
    Exposure, streak
        The time over which a camera collects light; the trail of a star or a light in this time.

Terms of integrity
    Main filter, subfilter
        The filter that uses all sources; a filter that excludes one source (or several), updated in parallel.
    Solution separation
        Difference between a subfilter and the main filter (Blanch et al. 2015, ARAIM).
    Fault detection and exclusion (FDE)
        Detection of an inconsistency, isolation of the faulty source, and its exclusion.
    Unresolved fault
        A fault that is detected but not isolated; the covariance is inflated.
    Excluded, monitored, reinstated
        A source that is not used; its innovations are still computed; it is used again after a time of consistency.
    Protection level, alert limit
        Bound of an error under an undetected fault; the largest acceptable protection level.

Terms of running
    Core, adapter, runtime
        The estimator of a node, without ROS; the conversion of messages to its types and back; the live execution.
    Time-ordered estimator
        Applies measurements in the order of their stamps and publishes outputs in order.
    Suite file
        The parameter file of all nodes of a ship.
    Bag, black box
        A recording of topics; a recording of all inputs and outputs of one node, which replays to the last bit.
    VALID, COASTING, DEGRADED, UNVERIFIED, INVALID
        The value rests on stars or lights; on recent ones; not on them; on unconfirmed stars; there is no value (NaN).
"""
