"""``apex arm ports``: the serial ports of this machine."""

import argparse
import json

from firmware_bridge.links.ports import ports

HELP = "list serial ports with names that survive replugging"
EXAMPLE = "apex arm ports --json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Print one line a port; 1 when there is none."""
    found = ports()
    if args.json:
        print(json.dumps([port._asdict() for port in found]))
    else:
        for port in found:
            usb = f"  usb {port.usb_id}" if port.usb_id else ""
            print(f"{port.stable or port.device}  {port.description}{usb}")
        if not found:
            print("no serial port found; is the cable a data cable, and the adapter plugged in?")
    return 0 if found else 1
