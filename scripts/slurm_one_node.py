"""A real SLURM of one node, this machine, for as long as a command runs; for trying `jghand train-many` on it.

    python scripts/slurm_one_node.py --install                          Debian's packages: munge, slurmctld, slurmd
    python scripts/slurm_one_node.py python -m pytest tests/cli/test_slurm.py
    python scripts/slurm_one_node.py bash                               a shell in which sbatch, squeue, scancel work

Wants root and Debian or Ubuntu; no systemd, no control groups, no accounting: munge, slurmctld and slurmd are started
by hand and end with the command, and so do all jobs. Everything lies in a folder of its own in the folder for temporary
files: a SLURM that is set up on the machine is not touched. The partition `low` can be preempted by jobs of `high`: a
polite kill, 20 seconds of grace, and back into the queue.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import secrets
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

PACKAGES = ("munge", "slurmctld", "slurmd", "slurm-client")
PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "srun", "squeue", "sinfo")
START_S, END_S = 30.0, 60.0

CONFIGURATION = """\
ClusterName=jghand
SlurmctldHost={host}
SlurmUser=root
AuthType=auth/munge
# a job that is queued again waits for its old credential to expire
AuthInfo=socket={folder}/munge.sock,cred_expire=15
SlurmctldPort={port}
SlurmdPort={node_port}
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
# without control groups, which a container may not have
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SwitchType=switch/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
JobRequeue=1
SchedulerParameters=batch_sched_delay=1,sched_interval=5,bf_interval=5
ReturnToService=2
KillWait=20
NodeName={host} CPUs={cores} RealMemory={memory_mb} State=UNKNOWN
PartitionName=low Nodes={host} Default=YES PriorityTier=1 PreemptMode=REQUEUE GraceTime=20 MaxTime=INFINITE State=UP
PartitionName=high Nodes={host} PriorityTier=2 PreemptMode=OFF MaxTime=INFINITE State=UP
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--install", action="store_true", help="install Debian's packages first")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="what is run while SLURM is up")
    options = parser.parse_args()
    if os.geteuid() != 0:
        print("This starts daemons that take the rights of others: it wants root.", file=sys.stderr)
        return 2
    if options.install:
        install()
    missing = [program for program in PROGRAMS if shutil.which(program) is None]
    if missing:
        print(f"Missing: {', '.join(missing)}. Run it with --install.", file=sys.stderr)
        return 2
    if not options.command:
        return 0
    # a polite kill ends the daemons too
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    with tempfile.TemporaryDirectory(prefix="jghand_slurm_") as folder, running(Path(folder)) as environment:
        return subprocess.run(options.command, env=environment, check=False).returncode


def install() -> None:
    """Debian's packages; their services are not started."""
    subprocess.run(["apt-get", "update", "-q"], check=True)
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "RUNLEVEL": "1"}
    command = ["apt-get", "install", "-q", "-y", "--no-install-recommends", *PACKAGES]
    subprocess.run(command, check=True, env=environment)


@contextlib.contextmanager
def running(folder: Path) -> Iterator[dict[str, str]]:
    """Starts the three daemons, waits until the node takes jobs, gives the environment in which the commands of SLURM
    speak to them, and ends them."""
    folder.chmod(0o755)  # munge refuses a socket that others cannot reach
    (folder / "munge").mkdir(mode=0o700)
    for name in ("state", "spool"):
        (folder / name).mkdir()
    key = folder / "munge" / "key"
    key.write_bytes(secrets.token_bytes(1024))
    key.chmod(0o400)
    host = socket.gethostname().split(".")[0]
    configuration = folder / "slurm.conf"
    configuration.write_text(
        CONFIGURATION.format(
            host=host, folder=folder, port=free_port(), node_port=free_port(), cores=os.cpu_count(),
            memory_mb=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20,
        ),
        encoding="utf-8",
    )  # fmt: skip
    environment = {**os.environ, "SLURM_CONF": str(configuration), "JGHAND_SLURM": "1"}
    munge = [
        "munged", "--foreground", "--force", f"--key-file={key}", f"--socket={folder}/munge.sock",
        f"--pid-file={folder}/munge/pid", f"--log-file={folder}/munge/log", f"--seed-file={folder}/munge/seed",
    ]  # fmt: skip
    with contextlib.ExitStack() as daemons:
        for command, sign in (
            (munge, lambda: (folder / "munge.sock").exists()),
            (["slurmctld", "-D", "-f", str(configuration)], lambda: says(["scontrol", "ping"], "is UP", environment)),
            (["slurmd", "-D", "-N", host, "-f", str(configuration)], lambda: says(["sinfo"], " idle ", environment)),
        ):
            daemons.enter_context(daemon(command, environment, folder))
            until = time.monotonic() + START_S
            while not sign():
                if time.monotonic() > until:
                    raise SystemExit(f"{command[0]} did not come up:\n{last_words(folder)}")
                time.sleep(0.2)
        try:
            yield environment
        finally:
            end_jobs(environment)


def end_jobs(environment: dict[str, str]) -> None:
    """Cancels all jobs and waits until they have ended: a training writes its checkpoint, and has KillWait for it."""
    subprocess.run(["scancel", "--full", "--user", str(os.getuid())], env=environment, check=False)
    until = time.monotonic() + END_S
    while time.monotonic() < until and says(["squeue", "--noheader"], " ", environment):
        time.sleep(0.5)


@contextlib.contextmanager
def daemon(command: list[str], environment: dict[str, str], folder: Path) -> Iterator[None]:
    with open(folder / f"{command[0]}.out", "wb") as log:
        process = subprocess.Popen(command, env=environment, stdout=log, stderr=log)
    try:
        yield
    finally:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def says(command: list[str], word: str, environment: dict[str, str]) -> bool:
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    return word in done.stdout


def last_words(folder: Path) -> str:
    logs = [*folder.glob("*.log"), *folder.glob("*.out"), folder / "munge" / "log"]
    texts = [(log, log.read_text(errors="replace")[-800:]) for log in logs if log.exists()]
    return "\n".join(f"--- {log.name}\n{text}" for log, text in texts if text)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("", 0))
        return probe.getsockname()[1]


if __name__ == "__main__":
    sys.exit(main())
