"""Messages written into a copy of a log, or alone."""

from bodylog.annotating.annotate import add_topics, open_annotation
from bodylog.io.atomic_files import replace_atomically
from bodylog.io.outputs import Output, guard_outputs
from bodylog.logs.conversion.transcode import LIBRARY, PROFILE
from bodylog.logs.mcap.prefix import NAME
from bodylog.logs.mcap.writer import Contents, McapRecordWriter


def annotate_log(source, outgoing, metadata, out, only=None):
    """Write `out` with the source, messages and metadata; returns the findings on topics that are not whole."""
    guard_outputs([source], [Output(out)])
    with open_annotation(source, out, whole=only is None) as under_way:
        findings = under_way.add(outgoing, only)
        under_way.about(metadata)
    return findings


def write_annotations(outgoing, metadata, out):
    """Write messages and metadata alone."""
    with replace_atomically(out) as beside, beside.open("wb") as stream:
        writer = McapRecordWriter(stream, Contents())
        writer.begin(PROFILE, LIBRARY)
        add_topics(writer, outgoing)
        writer.about(NAME, metadata)
        writer.finish()
