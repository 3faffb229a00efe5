"""A dilution series: carried out on the simulated rig, fitted and reported."""

import drivers
import tankrig

sequence = tankrig.load_sequence("dilution.toml")
description = drivers.simulated_rig("runs/first.rig")  # of your own rig: drivers.load_rig_file("rig.toml")
runner = tankrig.new_run(sequence, drivers.open_rig(description), "runs/first")
outcome = runner.run()

for fit in tankrig.refit(outcome.path):
    print(fit)
print(tankrig.write_report(outcome.path))
