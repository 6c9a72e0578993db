"""Networks that estimate a body's pose from a few inertial sensors: DIP and IMUPoser.

The DIP network (Huang et al. 2018) reads six sensors at 60 Hz; IMUPoser (Mollyn et al. 2023) any one to
three of five everyday devices at 25 Hz. `learned.online` streams them through the protocol of
`mocap.estimator`; `learned.training.trainer` trains them on virtual sensors put on motion capture.
"""
