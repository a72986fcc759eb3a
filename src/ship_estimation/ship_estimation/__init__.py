"""Estimation without ROS: Kalman filter with subfilters, fault isolation, protection levels and consistency tests.

- Filter: :mod:`ship_estimation.kalman.kalman_filter` (time and measurement update, covariance by error source),
  :mod:`ship_estimation.innovations.gates` (innovation gate, NEES, NIS).
- Fault detection and exclusion, with subfilters: :mod:`ship_estimation.fault_detection`.
- Integrity: :mod:`ship_estimation.integrity.protection_levels`, :mod:`ship_estimation.fault_detection.common_error`.
- Plausibility checks before a measurement is used: :mod:`ship_estimation.plausibility.ins_check` for the samples of an
  INS, :mod:`ship_estimation.plausibility.integrated_rates` for its rates,
  :mod:`ship_estimation.plausibility.stuck_check` for frozen values, :mod:`ship_estimation.plausibility.predictions` for
  jumps.
- Order of measurements and outputs: :mod:`ship_estimation.time_order.time_ordered_estimator`.
- Smoother: :mod:`ship_estimation.kalman.rts_smoother`.
- Diagnosis of sources from their innovations: :mod:`ship_estimation.innovations.innovation_diagnosis`.
- Recovery by a second estimator: :mod:`ship_estimation.recovery`.

Names, frames and units: :mod:`ship_geometry`. State vectors hold errors of named blocks. The main filter's covariance
is stored as a stack of parts, one for each error source; their sum is the covariance
(:mod:`ship_estimation.kalman.kalman_filter`).
"""
