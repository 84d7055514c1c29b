"""The command `tipfem compile`."""

STEPS = 40  # of each case: until the step's length follows the flow, and particles have been exchanged


def compile() -> int:
    """Compile the kernels of common cases, and keep their machine code, so that the first run starts at once.

    It takes minutes, and a second time seconds. Wheels have these kernels already.
    """
    from tipfem.backend.kept_kernels import kept
    from tipfem.backend.launch import every_schedule
    from tipfem.backend.runtime import init
    from tipfem.demos.support.small_cases import cases
    from tipfem.run.simulation import Simulation

    init()
    for _ in every_schedule():
        for case in cases():
            simulation = Simulation(case)
            for _ in range(STEPS):
                simulation.step()
    print(f"{kept()} kernels are ready")
    return 0
