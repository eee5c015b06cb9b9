"""`via watch --web`: estimates with their bands, samples, gaps, causes and warnings over time, in rerun's web viewer.

rerun (https://rerun.io) is the optional extra `view`: `make view`. Its server holds the latest data and serves the
viewer, on the loopback interface only. The viewer would report its use and look for news on the network; the page is
therefore passed on with a policy by which the browser connects to these two servers only. Joints are looked at 25 times
a second, whatever their rate; server and viewer forget the oldest data.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from math import isfinite, nan
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any
from urllib.parse import quote
from urllib.request import urlopen

from diagnostic_msgs.msg import DiagnosticStatus
from via_core.errors import ViaError
from via_core.metrics import WIDTH_95
from via_core.status import Status
from via_core.text_files import shown
from via_core.wire import SECOND

from via_bringup.cli.ros.watched import Samples, Watched

RERUN = (sys.executable, "-m", "rerun")
HOST = "127.0.0.1"
PERIOD = 0.04  # [s] between two looks
MEMORY = "256MB"  # of the server, for viewers that come late
TABS = {
    "stiffness": "stiffness [N m/rad]", "damping": "damping [N m s/rad]", "samples": "samples per second, missing ones",
    "gap": "gap over noise",
}  # fmt: skip
COLOURS, WIDTHS = ((130, 170, 230), (30, 90, 200), (130, 170, 230)), (1.0, 2.0, 1.0)  # lower end, value, upper end
LEVELS = {Status.OK.name: "INFO", Status.IMPLAUSIBLE.name: "ERROR"}  # others warn


@contextmanager
def viewer(port: int) -> Iterator[tuple[str, Any]]:
    """Address of the page and a stream of data for it, until the end of the block. Raises ViaError without rerun.

    port  of the page; the next one is that of the data
    """
    if find_spec("rerun") is None:
        raise ViaError("the web view needs rerun, which is not installed: make view, or pip install rerun-sdk")
    data = f"{HOST}:{port + 1}"
    with ExitStack() as stack:
        settings = {**os.environ, "XDG_CONFIG_HOME": stack.enter_context(TemporaryDirectory())}
        subprocess.run([*RERUN, "analytics", "disable"], env=settings, check=True, capture_output=True)
        _check_free(port + 1)
        page = stack.enter_context(_passed_on(port, data))
        os.environ.setdefault("RUST_LOG", "off")  # rerun would report that its server has ended
        from rerun import RecordingStream

        stream = RecordingStream("via")
        stack.callback(stream.disconnect)  # after the server has ended: it would wait for unsent data of many joints
        server = subprocess.Popen(
            [*RERUN, "--serve-web", "--bind", HOST, "--web-viewer-port", str(page), "--port", str(port + 1),
             "--server-memory-limit", MEMORY],
            env=settings, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip
        stack.callback(server.wait)
        stack.callback(os.killpg, server.pid, signal.SIGTERM)  # with the program that `python -m rerun` starts
        stream.connect_grpc(f"rerun+http://{data}/proxy")
        yield f"http://{HOST}:{port}/?url={quote(f'rerun+http://{data}/proxy', safe='')}", stream


def _check_free(port: int) -> None:
    with socket.socket() as tried:
        if tried.connect_ex((HOST, port)) == 0:
            raise ViaError(f"port {port} is in use; choose another one with --port")


@contextmanager
def _passed_on(port: int, data: str) -> Iterator[int]:
    """Serve at `port` what rerun will serve at the port returned; the page may connect to the address `data` alone."""
    _check_free(port)
    with socket.create_server((HOST, 0)) as unused:
        behind = int(unused.getsockname()[1])
    policy = f"default-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; connect-src 'self' http://{data}"

    class Passed(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            try:
                with urlopen(f"http://{HOST}:{behind}{self.path}") as answer:
                    content, kind = answer.read(), answer.headers.get("Content-Type", "text/plain")
                    code = answer.status
            except OSError as error:
                content, kind, code = str(error).encode(), "text/plain", getattr(error, "code", 502)
            self.send_response(code)
            for name, value in (
                ("Content-Type", kind), ("Content-Length", str(len(content))), ("Content-Security-Policy", policy)
            ):  # fmt: skip
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: Any) -> None:
            pass

    with ThreadingHTTPServer((HOST, port), Passed) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        yield behind
        server.shutdown()


class Page:
    """What has been sent of the joints; `stream` is rerun's RecordingStream."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self._joints: list[str] = []
        self._styled: set[str] = set()  # paths of bands
        self._told: dict[str, str] = {}  # latest text of each source

    def show(self, watched: Watched, joints: list[str] | None) -> None:
        """Send the present state of all joints or of these."""
        names = [each for each in watched.joints() if not joints or each in joints]
        if names != self._joints:
            self._joints = names
            self._stream.send_blueprint(_layout(names))
        for name in names:
            for method, estimates in watched.estimates(name).items():
                for quantity, estimate in estimates.items():
                    self._show_estimate(name, f"{quantity}/{method}", estimate)
            self._show_samples(name, watched.samples.get(name))
            self._show_gap(name, watched.gap(name))
        for warning in watched.warnings():
            level = "WARN" if warning.level == DiagnosticStatus.WARN else "ERROR"
            self._tell("warnings", warning.name, f"{warning.name}: {warning.message}", level)

    def _show_estimate(self, joint: str, path: str, estimate: Any) -> None:
        """Value and 95 % interval where the status is OK, else a gap in the line."""
        from rerun import Scalars, SeriesLines

        self._at(estimate)
        if f"{joint}/{path}" not in self._styled:
            self._styled.add(f"{joint}/{path}")
            style = SeriesLines(colors=COLOURS, widths=WIDTHS, names=["lower end, 95 %", "value", "upper end, 95 %"])
            self._stream.log(f"{joint}/{path}", style, static=True)
        value = estimate.value if estimate.status == Status.OK else nan
        half = WIDTH_95 * estimate.standard_deviation
        self._stream.log(f"{joint}/{path}", Scalars([value - half, value, value + half]))
        status = Status(estimate.status).name if estimate.status in set(Status) else "unknown status"
        self._tell(joint, f"{joint}/{path}", f"{path}: {status}", LEVELS.get(status, "WARN"))

    def _show_samples(self, joint: str, samples: Samples | None) -> None:
        from rerun import Scalars

        if samples is not None and isfinite(samples.rate):
            self._stream.set_time("time", timestamp=samples.stamps[-1] / SECOND)
            self._stream.log(f"{joint}/samples/rate", Scalars(samples.rate))
            self._stream.log(f"{joint}/samples/missing", Scalars(samples.gaps))

    def _show_gap(self, joint: str, gap: Any) -> None:
        from rerun import Scalars

        if gap is not None:
            self._at(gap)
            self._stream.log(f"{joint}/gap", Scalars(gap.residual_ratio))
            causes = ", ".join(f"{each.effect.name} {100.0 * each.probability:.0f} %" for each in gap.hypotheses)
            self._tell(joint, f"{joint}/gap", f"gap: {gap.verdict}{causes and f', {causes}'}", "INFO")

    def _at(self, message: Any) -> None:
        stamp = message.header.stamp
        self._stream.set_time("time", timestamp=stamp.sec + stamp.nanosec / SECOND)

    def _tell(self, path: str, source: str, text: str, level: str) -> None:
        """Add a line to the log at `path` if the text of its source has changed."""
        from rerun import TextLog

        if self._told.get(source) != text:
            self._told[source] = text
            self._stream.log(path, TextLog(shown(text), level=level))


def _layout(joints: list[str]) -> Any:
    """A tab for each quantity, with a plot for each joint, above the log."""
    from rerun import blueprint as layout

    grids = [
        layout.Grid(
            *(layout.TimeSeriesView(origin=f"{each}/{what}", name=f"{each}: {title}") for each in joints), name=what
        )
        for what, title in TABS.items()
    ]
    log = layout.TextLogView(origin="/", name="log")
    return layout.Blueprint(layout.Vertical(layout.Tabs(*grids), log, row_shares=[3, 1]), collapse_panels=True)
