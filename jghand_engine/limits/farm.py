"""Limits of work that a scheduler hands out."""

from __future__ import annotations

# ---- farm: trainings ------------------------------------------------------------------------------------------------
# seconds between two looks at a training: at its process by the job, at the jobs by who waits for them, at a cluster's
# queue, which all its users ask
JOB_POLL_S = 0.2
LOCAL_POLL_S = 0.5
SLURM_POLL_S = 10.0
# how long squeue may take to answer, seconds: longer than a busy cluster's
SLURM_ANSWER_S = 60.0
# seconds between two notes of how far a training is: a file on a disk that a cluster shares
RECORD_EVERY_S = 5.0
# how long the last note of a training is tried again where it cannot be written, seconds: a disk that was full, a
# server that starts again
RECORD_WAIT_S = 300.0
# how long a command waits for another that submits jobs of the same folder, seconds: sbatch takes some for a long list
SUBMIT_WAIT_S = 120.0
# seconds between two looks whether a lock is free that is waited for
LOCK_POLL_S = 0.2
# how long before its time is up a job is told, seconds, and how long its training may then take for its checkpoint: a
# step and the judged views take a few
SIGNAL_BEFORE_S = 90
CHECKPOINT_WAIT_S = 75.0
# how long a job that was told to stop waits for its scheduler to take it back, seconds: a longer grace (GraceTime) it
# does not outlast, and docs/SCALE.md says so
REQUEUE_WAIT_S = 300.0
# shortest time of one start that a cluster may be asked for, minutes: SLURM tells up to a minute earlier than it was
# asked to, and placing the Gaussians takes its time; with two minutes a training began again and again and never came
# to a step
SLURM_MINUTES_MIN = 10
# how often a training may come to the end of a job's time: each time it goes on
TIMEOUTS_MAX = 1000
# minutes that a local job may take: nothing else wants the machine (a year)
LOCAL_MINUTES_MAX = 525_600
# trainings of one list: an array of SLURM has at most 1,000 jobs where nobody changed its MaxArraySize; more are
# several lists
TRAININGS_MAX = 1_000
# bytes of a list of trainings: a kilobyte for each. The worst of this size that is no list took Python's parser 1.4
# seconds; ten times as much took 12 seconds and 340 MB
LIST_BYTES_MAX = 1_000_000
