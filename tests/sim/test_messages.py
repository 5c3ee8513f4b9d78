import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bodylog.sim import messages


@pytest.mark.parametrize("kind", [*messages.DEFINITIONS, "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/CameraInfo"])
def test_definition_is_complete_by_itself(kind):
    types = get_types_from_msg(messages.message_definition(kind).decode(), kind)
    empty = get_typestore(Stores.EMPTY)
    empty.register(types)
    assert {name: fields for name, fields in empty.fielddefs.items() if name == kind}[kind][1]
    assert empty.hash_rihs01(kind) == messages.type_store().hash_rihs01(kind)


def test_times_are_split_into_seconds_and_nanoseconds():
    message = messages.skin_array(1_767_225_600_000_000_001, messages.np.zeros(3, "f4"))
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1_767_225_600, 1)
