"""Motions and recordings in the browser: side by side, with a timeline, sensors as axes.

A body is drawn with the mesh that comes with poser, or with your own SMPL body (--smpl FILE); --body capsules
draws its bones alone. A recording without a
reference motion is shown as measured: a standing body with its instrumented joints turned. The page is
served to this machine only, unless --host names another address. Ctrl-C ends it.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

from poser import options
from poser.console import DONE, complain, progress
from poser.live import addresses

HELP = "motions and recordings in the browser"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="motions or recordings")
    parser.add_argument(
        "--port", type=addresses.port, default=8080,
        help="default: 8080, or the next free one; 0: any free one",
    )  # fmt: skip
    parser.add_argument(
        "--host", default=addresses.LOCALHOST, help="default: 127.0.0.1, this machine only"
    )
    parser.add_argument("--no-browser", action="store_true", help="open no browser")
    options.add_body(parser)
    options.add_reading(parser)


def run(args: Namespace) -> int:
    import threading
    import webbrowser

    from poser.viewer import stage, tracks
    from poser.viewer.player import Player

    options.check_body(args)
    reading = options.reading(args)
    found = []
    with progress("reading") as tell:
        for k, path in enumerate(args.files):
            tell(k / len(args.files), path.name)
            found.append(tracks.read(path, reading))
    made = stage.server(args.host, args.port)
    try:
        player = Player(made, found, args.body)
        url = f"http://{addresses.Address(args.host, made.get_port())}"
        complain(f"{url} (Ctrl-C ends it)", "view")
        if not args.no_browser:
            webbrowser.open(url)
        player.run(threading.Event())
    finally:
        stage.stop(made)
    return DONE
