"""Live: packets of body-worn sensors in, poses out, while the person moves.

    source -> packets -> assembler -> calibration -> Sample -> Estimator.step -> Pose -> sinks

Along that way:

- `sources`: a file each kind of device; `receiver`, `addresses`, `osc_messages`: what they share
- `packets`: what a message holds, and why it is refused
- `assembler`, `device_clock`: packets late, twice or out of order to rows on a regular clock; they know no
  socket and no time of day, so that tests drive them
- `aligner`, `alignment`, `device_headings`: from sensors to bones, at the start and after a reset (`asking`)
- `devices`: which consumer devices are worn, and where
- `samples`: the sources that an estimator reads; `opening` makes one from the words of the command line
- `loop`: samples through an estimator into `sinks`, and how late poses are (`latency`)

Beside it: what is said (`telling`, `listing`, `senders`, `sender_words`, `heard`), what is kept (`recorder`,
`spool`), help to put sensors on (`placement`, `identifying`), and simulated wearers (`device_study`).
"""
