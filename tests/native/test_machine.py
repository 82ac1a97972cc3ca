"""What machine this is."""

from jghand_engine.native.machine import processor


def test_the_processor_has_a_name_of_one_line():
    name = processor()
    assert name.strip() == name
    assert name
    assert "\n" not in name
    assert name == processor()
