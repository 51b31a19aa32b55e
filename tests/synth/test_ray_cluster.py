"""The same bytes from a Ray cluster as from this process."""

import pytest
from tests.synth.fake_production import FakeSet
from tests.synth.test_production import contents

from twohands.errors import InputError
from twohands.synth.executors import LocalProcesses
from twohands.synth.production import produce
from twohands.synth.ray_cluster import RayCluster


def test_workers_must_not_be_negative():
    with pytest.raises(InputError, match="workers must be 0"):
        RayCluster(workers=-1)


def _open_failure():
    raise InputError("no background picture")


@pytest.mark.slow
def test_a_local_cluster_writes_the_same_bytes(tmp_path):
    pytest.importorskip("ray", reason="needs the extra 'cluster'")
    cluster = RayCluster(workers=2)
    produce(FakeSet(11), tmp_path / "ray", cluster)
    produce(FakeSet(11), tmp_path / "here", LocalProcesses(1))
    assert contents(tmp_path / "ray") == contents(tmp_path / "here")
    with pytest.raises(InputError, match="no background picture"):
        list(cluster.run(_open_failure, [0]))
