"""A Slurm cluster on this machine, for one test: munge, a controller and some nodes, of Debian's packages."""

import getpass
import os
import re
import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path

from cli_case import PATIENCE

NEEDED = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel", "sinfo")
# Daemons stand where a user's PATH does not lead.
PATHS = os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/sbin"])
CONFIGURATION = """
ClusterName=penumbra
SlurmctldHost={host}(127.0.0.1)
SlurmctldPort={port}
SlurmUser={user}
SlurmdUser={user}
AuthType=auth/munge
CredType=cred/munge
AuthInfo=socket={root}/munge.socket
StateSaveLocation={root}/state
SlurmdSpoolDir={root}/spool-%n
SlurmctldPidFile={root}/slurmctld.pid
SlurmdPidFile={root}/%n.pid
SlurmctldLogFile={root}/slurmctld.log
SlurmdLogFile={root}/%n.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
MpiDefault=none
SlurmdParameters=config_overrides
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
ReturnToService=2
SlurmdTimeout={timeout_s}
KillWait=2
"""
# It looks at its queue more often than it does by default, where seconds lie between two tasks.
EAGER = "SchedulerParameters=batch_sched_delay=0,sched_interval=1,sched_min_interval=0,bf_interval=1\n"


def is_installed():
    return all(shutil.which(name, path=PATHS) for name in NEEDED)


def free_ports(count):
    sockets = [socket.socket() for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


def environment_of(process):
    try:
        words = Path(f"/proc/{process}/environ").read_bytes().split(b"\0")
    except OSError:
        return {}
    return dict(word.decode(errors="replace").partition("=")[::2] for word in words if b"=" in word)


def parent_of(process):
    try:
        return int(re.search(r"^PPid:\s+(\d+)", Path(f"/proc/{process}/status").read_text(), re.MULTILINE)[1])
    except (OSError, TypeError):
        return 0


class Cluster:
    """Nodes n1, n2, ... of so many cores each. `root` is an empty folder with a short path."""

    def __init__(self, root, nodes, cores=1, timeout_s=5, eager=True):
        self.root, self.running = Path(root), {}
        self.nodes = [f"n{i + 1}" for i in range(nodes)]
        self.environment = dict(os.environ, PATH=PATHS, SLURM_CONF=str(self.root / "slurm.conf"))
        for name in [name for name in self.environment if name.startswith(("SBATCH_", "SQUEUE_", "JOB_COMPLETION"))]:
            del self.environment[name]
        host, ports = socket.gethostname().split(".")[0], free_ports(nodes + 1)
        text = CONFIGURATION.format(host=host, port=ports[0], user=getpass.getuser(), root=self.root,
                                    timeout_s=timeout_s) + (EAGER if eager else "")
        for name, port in zip(self.nodes, ports[1:]):
            text += (f"NodeName={name} NodeHostname={host} NodeAddr=127.0.0.1 Port={port} CPUs={cores} "
                     "RealMemory=4000 State=UNKNOWN\n")
            (self.root / f"spool-{name}").mkdir()
        (self.root / "state").mkdir()
        (self.root / "slurm.conf").write_text(text + "PartitionName=all Nodes=ALL Default=YES State=UP\n")

    def start(self):
        key = self.root / "munge.key"
        key.write_bytes(os.urandom(128))
        key.chmod(0o400)
        self.run_daemon("munged", "munged", "--foreground", "--force", f"--key-file={key}",
                        f"--socket={self.root}/munge.socket", f"--pid-file={self.root}/munged.pid",
                        f"--log-file={self.root}/munged.log", f"--seed-file={self.root}/munged.seed")
        self.wait_for(lambda: (self.root / "munge.socket").exists(), "munge's socket")
        self.run_daemon("slurmctld", "slurmctld", "-D", "-c")
        for name in self.nodes:
            self.start_node(name)
        self.wait_for(lambda: self.states() == {"idle"}, "three idle nodes")

    def start_node(self, name):
        self.run_daemon(name, "slurmd", "-D", "-N", name)

    def run_daemon(self, name, *command):
        with (self.root / f"{name}.out").open("wb") as said:
            self.running[name] = subprocess.Popen(command, env=self.environment, cwd=self.root, stdout=said,
                                                  stderr=said, start_new_session=True)

    def states(self):
        told = self.ask("sinfo", "--noheader", "--Node", "--format=%N %t", check=False)
        found = dict(line.split() for line in told.splitlines())
        return {found.get(name, "none") for name in self.nodes}

    def ask(self, *command, check=True):
        done = subprocess.run(command, env=self.environment, capture_output=True, text=True, timeout=60, check=False)
        if check and done.returncode != 0:
            raise AssertionError(f"{command}: {done.stderr}")
        return done.stdout

    def wait_for(self, is_so, what, limit_s=60):
        until = time.monotonic() + limit_s * PATIENCE
        while not (found := is_so()):
            if time.monotonic() > until:
                raise AssertionError(f"{what} did not come in {limit_s} s\n{self.logs()}")
            time.sleep(.1)
        return found

    def logs(self):
        return "\n".join(f"{path.name}:\n{path.read_text(errors='replace')[-1500:]}"
                         for path in sorted(self.root.glob("*.out")) + sorted(self.root.glob("slurmctld.log")))

    def running_tasks(self):
        """(job_task, node) of each that runs."""
        told = self.ask("squeue", "--noheader", "--array", "--states=RUNNING", "--format=%i %N", check=False)
        return [tuple(line.split()) for line in told.splitlines() if len(line.split()) == 2]

    def programs_of(self, **variables):
        """What jobs of this cluster run, by variables that Slurm gave them."""
        wanted = variables | {"SLURM_CONF": self.environment["SLURM_CONF"]}
        return {int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()
                and wanted.items() <= environment_of(path.name).items()}

    def processes_of(self, node):
        """Of its jobs: their programs, and the keepers that Slurm puts over them."""
        programs = self.programs_of(SLURMD_NODENAME=node)
        keepers = {parent_of(one) for one in programs} - programs - {0, 1, os.getpid()}
        keepers = {one for one in keepers if b"slurmstepd" in self.name_of(one)}
        return programs | keepers

    @staticmethod
    def name_of(process):
        try:
            return Path(f"/proc/{process}/cmdline").read_bytes()
        except OSError:
            return b""

    def cut_off(self, node):
        """The machine is no longer reached, though what runs on it goes on."""
        self.end(node, signal.SIGKILL)

    def lose_power(self, node):
        self.end(node, signal.SIGKILL)
        self.kill(self.processes_of(node))

    def lose_power_at_work(self, node, command):
        """The job_task that was lost with it; None: none runs `command` just now, and nothing is lost."""
        held = self.processes_of(node)
        self.kill(held, signal.SIGSTOP)  # it cannot end while it is asked which it is
        task = next((task for task, where in self.running_tasks() if where == node), None)
        if task and any(self.name_of(process).startswith(command) for process in held):
            self.lose_power(node)
            return task
        self.kill(held, signal.SIGCONT)
        return None

    def kill_task(self, task):
        """All of a job_task at once: nothing is left that could begin it again. False: it has ended."""
        job, _, index = (task or "").partition("_")
        programs = self.programs_of(SLURM_ARRAY_JOB_ID=job, SLURM_ARRAY_TASK_ID=index)
        self.kill(programs)
        return len(programs) > 1

    @staticmethod
    def kill(processes, how=signal.SIGKILL):
        for process in sorted(processes):  # parents, which would begin them again, first
            try:
                os.kill(process, how)
            except ProcessLookupError:
                pass

    def cancel_all(self):
        self.ask("scancel", f"--user={getpass.getuser()}", check=False)

    def end(self, name, how=signal.SIGTERM):
        process = self.running.pop(name)
        process.send_signal(how)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def stop(self):
        if "slurmctld" in self.running:
            self.cancel_all()
        for node in self.nodes:
            if node in self.running:
                self.lose_power(node)
        for name in list(reversed(self.running)):
            self.end(name)
