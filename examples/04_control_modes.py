"""Drive joints in the three control modes: position, effort and set.

One sees: what gravity compensation and a higher gain are worth to a servo, a pitch that sinks once
its motor is off, a yaw under a constant torque, loops that hold meanwhile, and a pose that is set
without dynamics.
"""

from trocar.simulation import World

POSE = [0.4, 0.5, 0.15, 0.0, 0.0, 0.0]


def main() -> None:
    """Run the example."""
    world = World("psm", friction="paper")  # damping only: nothing sticks
    arm = world.arm("PSM1")
    arm.move_jp(POSE).wait(timeout_s=5.0)

    print('mode "position": PID on the commanded position')
    for on in (True, False):
        arm.joints.use_gravity_compensation(on)
        world.step(1000)
        off = 1e3 * (arm.measured_js().position - POSE)
        state = "on " if on else "off"
        print(f"  compensation {state}: yaw off by {off[0]:6.3f}, pitch by {off[1]:6.3f} mrad")
    p, i, d = arm.joints.gains("pitch")
    arm.joints.set_gains("pitch", p=4 * p)
    world.step(1000)
    off = 1e3 * (arm.measured_js().position[1] - POSE[1])
    print(f"  P of the pitch {p:g} -> {4 * p:g} (I {i:g}, D {d:g}): pitch off by {off:.3f} mrad")

    print('mode "effort": without a command no effort acts')
    before = arm.measured_js().position[1]
    arm.joints.set_mode("effort", ["pitch"])
    world.step(300)
    moved = arm.measured_js().position[1] - before
    print(f"  0.3 s without its motor: the pitch moved by {1e3 * moved:.1f} mrad")
    arm.joints.use_gravity_compensation(True)
    arm.joints.set_mode("effort")
    arm.servo_jf([0.2, 0.0, 0.0, 0.0, 0.0, 0.0])  # N m on the yaw; it acts until the next command
    world.step(300)
    print(f"  0.3 s of 0.2 N m on the yaw: it turns at {arm.measured_js().velocity[0]:.3f} rad/s")
    health = world.health()
    print(f"  the loops gape by {1e6 * health.loop_gap_m:.3f} um, branch right: {health.branch_ok}")

    print('mode "set": the joint is where it is commanded to be')
    arm.joints.set_mode("set")
    arm.servo_jp([-0.5, 0.2, 0.05, 1.0, 0.3, -0.2])
    position = arm.measured_js().position
    print("  at once, without a step: " + " ".join(f"{q:.2f}" for q in position))
    arm.joints.set_mode("position")  # the servos take over from here
    world.step(1000)
    print("  a second later:          " + " ".join(f"{q:.2f}" for q in arm.measured_js().position))


if __name__ == "__main__":
    main()
