#!/usr/bin/env python3
"""Prints the newest light of a running daemon whenever it changes.

usage: client_light.py [PAGE]
"""
import sys

import penumbra_client


def main():
    with penumbra_client.Client(sys.argv[1] if len(sys.argv) > 1 else None) as client:
        number = 0
        while True:
            light = client.wait(number, timeout_ms=2000)
            if light is None:
                print(f"{client.path}: nothing new for two seconds", file=sys.stderr)
                continue
            number = light.number
            print(f"light {number}, {light.age_ns / 1e6:.1f} ms old, mean radiance",
                  *(f"{c:.3f}" for c in light.mean_radiance))
            for one in light.lights[:light.light_count]:
                print(f"  light {one.id} towards", *(f"{c:.2f}" for c in one.direction), flush=True)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        pass
    except penumbra_client.Error as error:
        sys.exit(f"client_light: {error}")
