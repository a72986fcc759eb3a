"""Glossary of the suite: frames, rotations, terms, names and units.

Every module of every package uses these terms. ``docs/reference/glossary.md`` is generated from this docstring: a term
has a meaning, then its unit and frame, its source and the module that implements it, where they apply. The package
itself depends on no other package of the suite.

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
    v     forward, up, right       the device                   any device aboard where the code serves several kinds: a
                                                                star sensor or a reference
    r     forward, up, right       the device                   reference: another attitude system aboard
    b     forward, up, right       the body                     any body where the code serves several kinds: a drone
                                                                (nose, up, right); sensor or deck where stars are fitted
    f     bow, up, starboard       the hull                     foot of the theodolite: d rotated by the bending of the
                                                                hull between d and the foot since the survey
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
        Unit: rad, c; module: ship_stars.sky.catalogue.
    Direction without air
        Catalogue place after proper motion, parallax, light deflection, aberration and Earth rotation: SOFA's
        topocentric place.
        Unit: unit vector in n; source: IAU 2006/2000A; module: ship_geometry.earth.star_directions.
    Apparent place, apparent direction
        Direction of a star as seen from the ship, refraction included: SOFA's observed place. An almanac's apparent
        place is geocentric and without air.
        Unit: unit vector in n; module: ship_stars.sky.sky_model.
    Aberration
        Shift of a star's direction by the observer's velocity: 20″ by the Earth's orbit (annual), 0.3″ by its rotation
        (diurnal), 0.01″ by the ship.
        Unit: rad; module: ship_geometry.earth.star_directions.
    Refraction
        Angle by which the air raises the apparent place of a star or a light.
        Unit: rad; source: Hohenkerk, Sinclair 1985; module: ship_geometry.air.refraction.
    Sky model
        Apparent places of all stars for the ship's position, time and weather, with the errors that they share.
        Unit: unit vectors in n; module: ship_stars.sky.sky_model.
    Earth orientation parameters (EOP), UT1
        UT1 − UTC and polar motion, measured by the IERS; UT1 is the time scale of the Earth's rotation, 15″ per second.
        Unit: s; source: finals2000A; module: ship_geometry.earth.earth_orientation.
    Deflection of the vertical
        Angle from the ellipsoid normal Up to gravity's zenith, to which an INS levels itself: xi northward, eta
        eastward.
        Unit: rad; module: ship_attitude_star.vertical.

Terms of the ship
    INS
        Inertial navigation system: attitude and rate at about 100 Hz without gaps, with correlated errors.
        Module: ship_estimation.parameters.ship_devices.
    Star sensor
        Camera that measures the pixels of stars, or the attitude that it solves from them.
        Module: ship_stars.camera.camera.
    Reference
        Another attitude system aboard, without stars.
        Module: ship_stars.attitude_samples.
    Horizon attitude, inertial attitude
        Attitude of a sensor in n, and in c.
        Unit: azimuth, elevation, roll, rad; quaternion; module: ship_stars.sky.tracker_attitude.
    Sight line
        Straight line from a sensor to a star or a light; also called line of sight.
        Unit: unit vector; module: ship_geometry.mount.line_of_sight.
    Wahba's problem
        Find the rotation between two frames from directions that are known in both.
        Source: Wahba 1965; module: ship_geometry.wahba.
    Solution
        Attitude computed from stars, of one sensor, or of the deck by all sensors (*joint*).
        Unit: rad, n; module: ship_stars.attitude_from_stars.solution.
    Installation, mounting
        Orientation of a device on the deck: three angles, and a small rotation vector of their error.
        Unit: rad, d; module: ship_attitude_star.ship_attitude.model.
    Alignment
        Estimates of all installations and clocks by ``ship_attitude``, as a message and as a file.
        Module: ship_attitude_star.ship_attitude.alignment.
    Deck mask
        Obstruction on deck in the view of a sensor, as a polygon.
        Unit: azimuth and elevation, rad, d; module: ship_stars.sky.deck_masks.
    Flexure
        Bending of the hull between the INS and a sensor.
        Unit: rad, d; module: ship_attitude_star.ship_attitude.model.
    Time offset tau
        A sample of a source is valid at its stamp + tau.
        Unit: s; module: ship_attitude_star.ship_attitude.model.
    Exposure, streak
        Time over which a camera collects light; trail of a star or light during this time.
        Unit: s; module: ship_geometry.tracks.exposure_mean.
    Pixel dwell
        Series of exposures in which the stars stay near the same pixels, so that pixel errors do not average out.
        Module: ship_stars.camera.errors.

Terms of the theodolite
    Main optical axis
        Forward axis of m: the direction in which the theodolite points.
        Unit: rad, n; module: theodolite_calib.optical_axis.
    Axis geometry
        Rotations from the ship's attitude through foot and mount to the main optical axis.
        Module: ship_geometry.mount.axes.
    Encoder
        Scale on an axis of the mount; two encoders measure azimuth and elevation.
        Unit: rad, d; module: theodolite_calib.samples.encoder_check.
    Axis errors
        Terms of a pointing model: zero points g and h of the encoders, collimation c, non-perpendicularity I, tilt
        beta_x, beta_y of the vertical axis, flexure of the tube. TPOINT has IA, IE, CA, NPAE, AN, AW and TF for them.
        Unit: rad; source: Wallace 2002; module: ship_geometry.mount.axes.
    Collimation c
        Angle of the optical axis against the normal to the horizontal axis.
        Unit: rad; module: ship_geometry.mount.axes.
    Non-perpendicularity I
        Tilt of the horizontal axis against the normal to the vertical axis.
        Unit: rad; module: ship_geometry.mount.axes.
    Parallelism
        Three angles from the axis of the calibration telescope to the main optical axis.
        Unit: rad, t; module: ship_geometry.mount.axes.
    Deformation
        Bending of the hull between the INS and the theodolite's foot: f relative to d.
        Unit: rad, d; module: theodolite_calib.filter.model.
    Calibration
        Estimates of axis errors, focal length and deformation by ``optical_axis``, as a message and as a file.
        Module: theodolite_calib.optical_axis.calibration.
    Beacon, light
        Drone whose position is measured by RTK; the lamp on it that the telescope observes.
        Module: ship_geometry.mount.line_of_sight.
    Baseline
        Vector from the ship's antenna to the antenna of a beacon.
        Unit: m, n; module: theodolite_calib.samples.tracks.
    Lever
        Vector between two points of one rigid body: from an antenna to a lens or to a light.
        Unit: m, d or b; module: ship_geometry.mount.line_of_sight.
    Principal point
        Of the lens (N'): point of the telescope at which sight lines meet. Of the detector: intersection with the axis
        of the lens.
        Unit: m; module: ship_geometry.mount.image.
    Sighting
        Measurement of the axis by one exposure of the telescope, or by one row of a table.
        Module: theodolite_calib.samples.sighting.

Terms of estimation
    Innovation
        Measured minus predicted, with its covariance.
        Unit: that of the measurement; module: ship_estimation.innovations.innovation_statistics.
    Normalised innovation
        Innovation divided by its standard deviation.
        Unit: sigmas; module: ship_estimation.innovations.innovation_statistics.
    Whitened innovation
        Innovation multiplied by an inverse square root of its covariance; the covariance of the product is the unit
        matrix.
        Unit: sigmas; module: ship_kernels.compiled_innovations.
    NIS, NEES
        Normalised innovation squared and normalised estimation error squared: e^T P^-1 e; the mean is the number of
        components if P is consistent.
        Source: Bar-Shalom, Li, Kirubarajan 2001; module: ship_estimation.innovations.gates.
    Windowed innovation mean
        Exponential mean of the whitened innovations of a source over 3, 30 or 300 measurements.
        Unit: sigmas; module: ship_estimation.fault_detection.isolation.
    Innovation gate
        Threshold of the NIS above which a measurement is rejected.
        Module: ship_estimation.innovations.gates.
    Plausibility check
        Check of a source before its measurement is used: frozen value, jump, rates.
        Module: ship_estimation.plausibility.ins_check.
    Motion reference
        Another source that shows the motion of the ship for a plausibility check.
        Module: ship_estimation.plausibility.stuck_check.
    Measurement decision
        A measurement is accepted or rejected.
        Module: ship_estimation.time_order.outcome.
    Rejection, conflict
        A measurement that is not used, with its reason; a series of rejections of one source, or different data with
        one stamp.
        Module: ship_estimation.rejection_rules.
    Innovation diagnosis
        Statistical test of a source's innovations: are sigma, alignment and clock as configured?
        Module: ship_estimation.innovations.innovation_diagnosis.
    Covariance by error source (error budget)
        Parts of a covariance, one for each named cause of error; their sum is the covariance.
        Unit: rad², n; module: ship_estimation.kalman.kalman_filter.
    White, correlated, constant error
        Error that is independent in each sample; that has a correlation time (Gauss–Markov); that is constant.
        Module: ship_estimation.kalman.kalman_filter.
    Covariance inflation
        Addition of the covariance of a possible jump or fault to that of the estimate.
        Unit: rad², n; module: ship_attitude_star.ship_attitude.faults.ins_fault_handling.
    Prior
        Estimate before a measurement, with its covariance.
        Module: ship_estimation.kalman.kalman_filter.

Terms of integrity
    Main filter, subfilter
        Filter that uses all sources; filter that excludes one source or several, updated in parallel.
        Module: ship_estimation.fault_detection.subfilters.
    Solution separation
        Difference between the estimates of a subfilter and of the main filter.
        Unit: rad, n; source: Blanch, Walter, Enge and others 2015; module: ship_estimation.integrity.protection_levels.
    Fault detection and exclusion (FDE)
        Detection of an inconsistency, isolation of the faulty source, and its exclusion.
        Module: ship_estimation.fault_detection.
    Unresolved fault
        Fault that is detected but not isolated; the covariance is inflated.
        Module: ship_estimation.fault_detection.exclusion.
    Excluded, monitored
        A source is not used; its innovations are still computed.
        Module: ship_estimation.fault_detection.exclusion.
    Reinstatement
        An excluded source is used again after a time of consistency.
        Module: ship_estimation.fault_detection.exclusion.
    Mounting shift
        Step of the installation of a device.
        Unit: rad, d; module: ship_watch.sources.source_history.
    Drift
        Slow change of an attitude or of a mounting.
        Unit: rad, n or d; module: ship_estimation.plausibility.rate_comparison.
    Protection level, alert limit
        Bound of an error under an undetected fault; largest acceptable protection level.
        Unit: rad; module: ship_estimation.integrity.protection_levels.
    VALID, COASTING, DEGRADED, UNVERIFIED, INVALID
        The value rests on stars or lights; on recent stars or lights; on neither; on too few stars to detect a
        misidentified star; there is no value (NaN).
        Module: ship_estimation.time_order.outcome.
    SAFE, CAUTION, UNSAFE
        An angle is within the limits of the ship; usable with care; not usable.
        Module: ship_watch.safety.safety.

Terms of running
    Stamp, log time, timeout clock
        Time of a measurement in its message; time at which a recorder wrote the message; monotonic time for timeouts.
        Unit: ns; module: ship_node.live.node_clock.
    Lag
        Maximum delay of a measurement that is still applied at its own time.
        Unit: s; module: ship_estimation.time_order.time_ordered_estimator.
    Time-ordered estimator
        Applies measurements in the order of their stamps and publishes outputs in order.
        Module: ship_estimation.time_order.time_ordered_estimator.
    Pending, commit
        A measurement waits for data that may still arrive; after the lag its decision is final.
        Module: ship_estimation.time_order.time_ordered_estimator.
    Batch
        Consecutive messages and ticks that a node processes in one call; live, one message.
        Module: ship_node.messages.inputs_outputs.
    Core, adapter
        Estimator of a node, without ROS; conversion of messages to its types and back.
        Module: ship_node.adapters.adapter.
    Node runtime
        Live execution of an adapter: messages, clocks, parameters, services, exit codes.
        Module: ship_node.live.node_runtime.
    Suite file
        Parameter file of all nodes of a ship.
        Module: ship_node.parameters.parameter_file.
    Bag, black box
        Recording of topics; recording of all inputs and outputs of one node, which replays to the last bit.
        Module: ship_node.black_box.
"""
