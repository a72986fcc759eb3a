"""Estimation without ROS: Kalman filter with subfilters, fault isolation, protection levels and consistency tests.

- Filter: :mod:`ship_estimation.kalman` (time and measurement update, covariance by error source),
  :mod:`ship_estimation.subfilters`, :mod:`ship_estimation.gates` (innovation gate, NEES, NIS).
- Fault detection and exclusion: :mod:`ship_estimation.innovation_means`, :mod:`ship_estimation.fault_isolation`,
  :mod:`ship_estimation.protection_levels`, :mod:`ship_estimation.common_error`.
- Plausibility checks before a measurement is used: :mod:`ship_estimation.ins_check` for the samples of an INS,
  :mod:`ship_estimation.rate_consistency` for its rates, :mod:`ship_estimation.value_checks` for frozen values, jumps.
- Order of measurements and outputs: :mod:`ship_estimation.time_ordered_estimator`.
- Smoother: :mod:`ship_estimation.rts_smoother`, with the backward step of :mod:`ship_estimation.rts_step`.
- Diagnosis of sources from their innovations: :mod:`ship_estimation.innovation_diagnosis`.
- Recovery by a second estimator: :mod:`ship_estimation.recovery`.

Names, frames and units: :mod:`ship_geometry`. State vectors hold errors of named blocks. The main filter's covariance
is stored as a stack of parts, one for each error source; their sum is the covariance (:mod:`ship_estimation.kalman`).
"""
