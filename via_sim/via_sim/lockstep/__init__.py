"""Many parameter rows of one joint under commands of one recording: LANES runs in lockstep, in vector registers.

Between events the right-hand side is smooth (`via_sim.joint.torques`), and most ticks of most runs have no event. A
block of runs therefore takes the same Krogstad step together, in packs of one number per run (`pack`).

A run takes a tick alone (`kernel.advance_tick`) when one of its axes stops, breaks away or crosses a flank of its gap,
when it meets a wall, or when its Maxwell element begins to slip. It takes all ticks alone when lockstep does not
implement one of its terms (`lanes.is_supported`): dead time in fractions of a tick, servos, a position drive with
speed limit, lag or a periodic encoder error.

Results differ from `kernel.run` by rounding only, where sine and exponential take part.
"""
