"""Live: packets of body-worn sensors in, poses out, while the person moves.

    source -> packets -> assembler -> calibration -> Sample -> Estimator.step -> Pose -> sinks

`packets` says what a message holds and refuses what does not fit. `clock` and `assembler` turn what
arrives late, twice, in another order or not at all into rows on a regular clock; they know no socket
and no time of day, so that tests drive them. `sources` and `sinks` are the two ends, `loop` drives an
estimator between them and measures how late its poses are. `devices` tells which consumer devices are
worn, and where.
"""
