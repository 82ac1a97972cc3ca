"""A program that behaves like `jghand … --progress-json`, or misbehaves: usage: stand_in_job.py FAULT [file=FILE] …

Knows nothing of JGHand. The end of its standard input is its Ctrl-C, unless the fault is not to listen.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time


def tell(**content):
    sys.stderr.write(json.dumps(content) + "\n")
    sys.stderr.flush()


def watch():
    while os.read(0, 4096):
        pass
    signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)


def work(steps, pause_s):
    for step in range(steps + 1):
        tell(jghand="progress", text="Counting", done=step, total=steps, eta_s=(steps - step) * pause_s)
        time.sleep(pause_s)


def main(fault, file):
    if fault == "deaf":
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    else:
        threading.Thread(target=watch, daemon=True).start()
    if fault == "flood":
        for number in range(20000):
            sys.stdout.write("noise " * 20 + "\n")
            tell(jghand="progress", text="Counting", done=number, total=20000, eta_s=None)
        sys.stderr.write("x" * 1_000_000 + "\n")
        return 0
    if fault == "orphan":
        # it holds the pipes open for longer than its parent lives
        subprocess.Popen([sys.executable, "-c", "import time; time.sleep(30)"])
        return 0
    if fault == "die":
        sys.stderr.write("Traceback: something broke\n")
        return 1
    if fault == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if fault == "disk full":
        tell(jghand="error", kind="disk_full", text="cannot write x: the disk is full.", exit_code=3)
        return 3
    if fault == "nonsense":
        for line in ("{", "{}", '{"jghand": 3}', '{"jghand": "progress", "done": "x", "total": null}', "\x00\xff"):
            sys.stderr.write(line + "\n")
        tell(jghand="progress", text=None, done=True, total=-1, eta_s="soon")
        return 0
    if fault == "arguments":
        return 2 if "--no-such" in sys.argv else 0
    try:
        work({"short": 3, "hours": 1_000_000}.get(fault, 1000), 0.02)
    except KeyboardInterrupt:
        if file:
            # as a training writes its checkpoint
            with open(file, "w") as stream:
                stream.write("checkpoint")
        if fault == "full at the end":
            tell(jghand="error", kind="disk_full", text="cannot write x: the disk is full.", exit_code=3)
            return 3
        tell(jghand="error", kind="canceled", text="Stopped.", exit_code=130)
        return 130
    return 0


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if not word.startswith("--")]
    files = [word.removeprefix("file=") for word in words if word.startswith("file=")]
    sys.exit(main(words[0], files[0] if files else ""))
