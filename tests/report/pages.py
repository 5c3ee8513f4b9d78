"""Whole pages, their parts, and names that try to leave their place."""

import json
import re
from dataclasses import replace

import numpy as np

from bodylog.report.page.page import write_report_page
from bodylog.report.viewers.image_overlay import OverlayPicture
from bodylog.types import Fault, Finding, Health, Score
from tests.changed_recordings import change_recording
from tests.report.records import SCORES, estimate, features, recording

HOSTILE = "</script><script>window.hit=1</script><img src=x onerror=window.hit=1>&amp;\u2028\u202e\x00'\"$"
LIMIT = 3_000_000


def report(path, **changes):
    """A page with everything on it, and its text."""
    parts = {"estimate": estimate(), "features": features(), "recording": recording(), "scores": SCORES}
    write_report_page(path, **(parts | {"pictures": (), "provenance": {}} | changes))
    return path.read_text(encoding="utf-8")


def plotted(page):
    """The data of the page as its script gets them."""
    (group,) = json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)[1])
    return group


def titles(page):
    return [panel["title"] for panel in plotted(page)["panels"]]


def hostile_parts():
    name = HOSTILE
    log = recording(joints=(name, "b", "c"), name=name)
    return {
        "estimate": replace(
            estimate(joints=(name, "b", "c")),
            method=name,
            errors={name: estimate().errors["effector"]},
            used={name: Health(2, 1, {name: 1})},
            faults=(Fault(name, name, name, 3.0, 0.1, name),),
            findings=(Finding(name, name),),
            settings={name: name, "offsets": {name: {"value": None, "std": 1.0, "confused_with": [name]}}},
            kinematic={name: estimate().predicted["effector"]},
            predicted={name: estimate().predicted["effector"], "effector": estimate().predicted["effector"]},
        ),
        "features": features(tracks={name: features().tracks["effector"]}, findings=(Finding("lost", name),)),
        "recording": change_recording(log, roles={name: name}, health={name: Health(1, 0, {name: 1})}, format=name),
        "scores": (Score(name, 1.0, name),),
        "pictures": (OverlayPicture(1.0, np.zeros((20, 30, 3), np.uint8), name),),
        "provenance": {name: name},
        "headline": {name: name},
    }
