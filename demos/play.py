"""A tank of water and oil to play with in a browser: tilt it, stir it, poke it, drop something into it.

    python demos/play.py

The page has a pendulum that tilts gravity, a hand that pushes the fluids where it is dragged, and drops. Neither is
compared with anything; what you do is in out/play/steering.jsonl, and `--steering` repeats it.
"""

import argparse

import tipfem as tp

parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0], prog="tipfem demo play")
parser.add_argument("--spacing", type=float, default=0.03, help="of the particles [m]; 0.03 makes 1,300 of them")
parser.add_argument("--time-step", type=float, default=0.01, help="the largest [s]")
parser.add_argument("--end-time", type=float, default=float("inf"), help="simulated [s]; by default until stopped")
parser.add_argument("--rate", type=float, default=15.0, help="most pictures per second")
parser.add_argument("--port", type=int, help="of 127.0.0.1; by default 8800 or one of the next")
parser.add_argument("--no-browser", action="store_true", help="open none; the address is printed in either case")
parser.add_argument("--native", action="store_true", help="in a window of its own, not in a browser")
parser.add_argument("--paused", action="store_true", help="begin with a pause")
parser.add_argument("--steering", help="the steering.jsonl of an earlier run, to repeat what was done in it")
parser.add_argument("--threads", type=int, default=1, help="of the simulation; the viewer has a core of its own")
parser.add_argument("--out", default="out/play", help="folder for the results")


def case(spacing: float) -> tp.Case:
    """Water below a lighter oil that is a hundred times as viscous, in a tank 1.2 m wide and 0.9 m high."""
    water = tp.Fluid("water", density=998.2, viscosity=1.002e-3)
    oil = tp.Fluid("oil", density=850.0, viscosity=0.1)
    tank = tp.tank(size=(1.2, 0.9), spacing=spacing)
    tank.fill(oil)
    tank.fill(water, box=((0, 0), (1.2, 0.39)))
    return tp.Case(tank, fluids=[water, oil], gravity=(0, -9.81), title="Water and oil to play with")


def main() -> None:
    """Run until the page says stop, or Ctrl-C."""
    options = parser.parse_args()
    simulation = None
    try:
        tp.init(threads=options.threads)
        simulation = tp.Simulation(
            case(options.spacing), options.out, time_step=options.time_step, steering=options.steering
        )
        tp.live(
            simulation,
            options.end_time,
            port=options.port,
            rate=options.rate,
            browser=not options.no_browser,
            paused=options.paused,
            native=options.native,
            say=lambda line: print(line, flush=True),
        )
    except ValueError as error:
        raise SystemExit(f"error: {error}") from None
    except KeyboardInterrupt:
        if simulation is None:
            raise SystemExit(130) from None
    print(f"{simulation.step_number} steps to t = {simulation.time:.3g} s; results: {options.out}")


if __name__ == "__main__":
    main()
