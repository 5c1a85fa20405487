"""A page in a headless Chromium, asked by a script that stands in a copy of it."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_QUIET = "--headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking --window-size=1500,1000"
_QUIET += " --virtual-time-budget=60000 --dump-dom"
_LISTEN = """<script>
const complaints = [], requests = () => performance.getEntriesByType("resource").map((entry) => entry.name);
for (const kind of ["error", "unhandledrejection", "securitypolicyviolation"])
  addEventListener(kind, (event) => complaints.push(kind + String(event.message || event.reason || event.blockedURI)));
requestAnimationFrame = (draw) => setTimeout(() => draw(performance.now()), 16);  // no frame is drawn here
for (const kind of ["error", "warn", "assert"]) console[kind] = (...words) => complaints.push(String(words));
</script>"""
_ASK = """<script>
addEventListener("load", async () => {
  const answer = await (async () => { %s })().catch((error) => String(error));
  parent.postMessage(JSON.stringify([answer, complaints, requests()]), "*");
});
</script>"""
_FRAME = """<iframe src="asked.html" style="width: %dpx; height: 900px; border: 0"></iframe><pre id="answer"></pre>
<script>addEventListener("message", ({data}) => { document.getElementById("answer").textContent = data; });</script>"""


def asked(page: Path, script: str, folder: Path, width: int = 1400) -> Any:
    """What a script returns on a page of some width, which must not complain or load; else skipped."""
    program = next(filter(None, map(shutil.which, _NAMES)), None)
    if program is None:
        pytest.skip(f"needs a browser: none of {', '.join(_NAMES)} is installed")
    text, frame = page.read_text(encoding="utf-8"), folder / "frame.html"
    text = text.replace("<head>", f"<head>{_LISTEN}", 1).replace("</body>", f"{_ASK % script}</body>", 1)
    (folder / "asked.html").write_text(text, encoding="utf-8")
    frame.write_text(_FRAME % width, encoding="utf-8")  # a window has a least width, a frame has none
    command = [program, *_QUIET.split(), f"--user-data-dir={folder}", frame.as_uri()]
    shown = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True).stdout
    (text,) = re.findall('<pre id="answer">(.*?)</pre>', shown)
    answer, complaints, requests = json.loads(html.unescape(text))
    assert complaints == [] and all(address.startswith("data:") for address in requests), (complaints, requests)
    return answer
