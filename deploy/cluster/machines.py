"""The parts of a cluster on one machine: PostgreSQL, replicas, HAProxy, nginx, Prometheus, and a wire that can be cut."""
import json
import os
import pwd
import shutil
import signal
import socket
import subprocess
import threading
import time
import urllib.parse
import urllib.request

POSTGRES = "/usr/lib/postgresql/15/bin/"


def missing():
    """What is not installed, in words; empty: nothing."""
    wanted = [(POSTGRES + "initdb", "postgresql-15"), (haproxy_program(), "haproxy"), (nginx_program(), "nginx"),
              (shutil.which("prometheus"), "prometheus")]
    return ", ".join(package for program, package in wanted if not program or not os.access(program, os.X_OK))


def haproxy_program():
    return shutil.which("haproxy") or "/usr/sbin/haproxy"


def nginx_program():
    return shutil.which("nginx") or "/usr/sbin/nginx"


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def await_true(what, condition, most_s=60.0, step_s=0.02):
    end = time.monotonic() + most_s
    while not condition():
        if time.monotonic() > end:
            raise AssertionError("not within %d s: %s" % (most_s, what))
        time.sleep(step_s)


def cpu_seconds(pid):
    with open("/proc/%d/stat" % pid) as stat:
        fields = stat.read().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def memory_mb(pid):
    """Resident."""
    with open("/proc/%d/status" % pid) as status:
        return int(next(line for line in status if line.startswith("VmRSS")).split()[1]) / 1024


class Stopped:
    """What runs as self.process and is stopped by a signal, its own or another."""

    SIGNAL = signal.SIGTERM

    def stop(self, how=None):
        if self.process is not None:
            self.process.send_signal(how or self.SIGNAL)
            self.process.wait()
            self.process = None

    def kill(self):
        self.stop(signal.SIGKILL)


class Postgres(Stopped):
    """A server of its own, not of root. follow: the server whose standby it becomes; archives: its WAL is archived."""

    SIGNAL = signal.SIGINT

    def __init__(self, folder, name, follow=None, archives=False):
        self.data = os.path.join(folder, name)
        self.log = os.path.join(folder, name + ".log")
        self.port = free_port()
        self.process = None
        self.owner = None
        if os.geteuid() == 0:
            self.owner = next(u for u in pwd.getpwall() if u.pw_name in ("postgres", "nobody"))
        self._make_folder(self.data)
        self.archive = self.data + "-archive" if archives else None
        if archives:
            self._make_folder(self.archive)
        if follow is None:
            self._run("initdb", "-D", self.data, "-U", "horopter", "-A", "trust", "-E", "UTF8", "--locale=C.UTF-8", "--no-sync")
        else:
            follow.back_up(self.data, "-R")
        self.start()

    def _make_folder(self, path):
        os.makedirs(path, mode=0o700)
        if self.owner is not None:
            os.chown(path, self.owner.pw_uid, self.owner.pw_gid)

    def back_up(self, path, *more):
        """A base backup into a folder that is empty or not there."""
        if not os.path.exists(path):
            self._make_folder(path)
        self._run("pg_basebackup", "-D", path, "-h", "127.0.0.1", "-p", str(self.port), "-U", "horopter", "--no-sync", "-c", "fast",
                  "-X", "stream", *more)

    def restore(self, backup, moment):
        """Stopped, replaced by the base backup and the archived WAL up to a moment (timestamptz), and started."""
        self.stop()
        shutil.rmtree(self.data)
        os.rename(backup, self.data)
        with open(os.path.join(self.data, "postgresql.auto.conf"), "a") as settings:
            settings.write("restore_command = 'cp %s/%%f %%p'\nrecovery_target_time = '%s'\nrecovery_target_action = promote\n" % (
                self.archive, moment))
        signal_file = os.path.join(self.data, "recovery.signal")
        open(signal_file, "w").close()
        if self.owner is not None:
            os.chown(signal_file, self.owner.pw_uid, self.owner.pw_gid)
        self.start()
        await_true("it is restored", lambda: self.sql("SELECT pg_is_in_recovery()") == "f", 60)

    def _command(self, program, *arguments):
        words = [POSTGRES + program, *arguments]
        if self.owner is not None:
            words = ["setpriv", "--reuid=%d" % self.owner.pw_uid, "--regid=%d" % self.owner.pw_gid, "--clear-groups", "--"] + words
        return words

    def _run(self, program, *arguments):
        done = subprocess.run(self._command(program, *arguments), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
                              cwd="/", check=False)
        if done.returncode != 0:
            raise AssertionError("%s: %s" % (program, done.stdout))
        return done.stdout

    def start(self):
        archiving = ["-c", "archive_mode=on", "-c", "archive_command=cp %p " + self.archive + "/%f"] if self.archive else []
        for _ in range(60):
            with open(self.log, "a") as log:
                self.process = subprocess.Popen(self._command(
                    "postgres", "-D", self.data, "-p", str(self.port), "-k", "", "-c", "listen_addresses=127.0.0.1", "-c",
                    "shared_buffers=32MB", "-c", "recovery_init_sync_method=syncfs", "-c", "wal_level=replica", *archiving),
                    stdout=log, stderr=log, cwd="/")
            while self.process.poll() is None:
                if subprocess.run([POSTGRES + "pg_isready", "-q", "-h", "127.0.0.1", "-p", str(self.port)]).returncode == 0:
                    return
                time.sleep(0.05)
            time.sleep(0.1)  # children of one that was killed hold its memory a moment longer
        raise AssertionError("PostgreSQL does not start: " + open(self.log).read()[-2000:])

    def sql(self, text):
        return self._run("psql", "-h", "127.0.0.1", "-p", str(self.port), "-U", "horopter", "-d", "postgres", "-X", "-q", "-A", "-t",
                         "-v", "ON_ERROR_STOP=1", "-c", text).strip()

    def script(self, path):
        self._run("psql", "-h", "127.0.0.1", "-p", str(self.port), "-U", "horopter", "-d", "postgres", "-X", "-q", "-v", "ON_ERROR_STOP=1",
                  "-f", path)

    def promote(self):
        self.sql("SELECT pg_promote()")

    def address(self, *others):
        hosts = ",".join("127.0.0.1:%d" % p.port for p in (self, *others))
        return "postgresql://horopter@%s/postgres" % hosts


class Replica(Stopped):
    """horopterd; more: further arguments, environment: beside that of the test."""

    def __init__(self, program, folder, name, address, more=(), environment=None):
        self.program, self.name, self.address, self.more = program, name, address, list(more)
        self.environment = dict(os.environ, **(environment or {}))
        self.log = os.path.join(folder, name + ".log")
        self.port, self.metrics = free_port(), free_port()
        self.process = None

    @property
    def target(self):
        return "127.0.0.1:%d" % self.port

    def start(self):
        with open(self.log, "a") as log:
            self.process = subprocess.Popen(
                [self.program, "--db", self.address, "--listen", self.target, "--workers", "1", "--cores", "1",
                 "--threads-per-request", "1", "--max-watchers", "0", "--drain-seconds", "20",
                 "--metrics-listen", "127.0.0.1:%d" % self.metrics, *self.more], stdout=log, stderr=log, env=self.environment)

    def cpu_seconds(self):
        return cpu_seconds(self.process.pid)

    def said(self, text):
        with open(self.log) as log:
            return text in log.read()


class Haproxy:
    def __init__(self, folder, replicas, workers=1, queue=8):
        self.port, self.stats = free_port(), free_port()
        self.socket = os.path.join(folder, "haproxy.sock")
        self.log = os.path.join(folder, "haproxy.log")
        environment = dict(os.environ, HOROPTER_BIND=self.target, HOROPTER_WORKERS=str(workers), HOROPTER_QUEUE=str(queue),
                           HOROPTER_SOCKET=self.socket, HOROPTER_STATS="127.0.0.1:%d" % self.stats)
        for i, replica in enumerate(replicas):
            environment["HOROPTER_REPLICA%d" % (i + 1)] = replica.target
        config = os.path.join(os.path.dirname(os.path.abspath(__file__)), "haproxy.cfg")
        self.process = subprocess.Popen([haproxy_program(), "-db", "-f", config], env=environment,
                                        stdout=open(self.log, "w"), stderr=subprocess.STDOUT)

    @property
    def target(self):
        return "127.0.0.1:%d" % self.port

    def stop(self):
        self.process.terminate()
        self.process.wait()


class Nginx(Stopped):
    """nginx.conf with the addresses of these replicas in place of its own."""

    def __init__(self, folder, replicas):
        self.port = free_port()
        with open(os.path.join(os.path.dirname(os.path.abspath(__file__)), "nginx.conf")) as config:
            text = config.read()
        servers = iter(replicas)
        lines = []
        for line in text.splitlines():
            words = line.split()
            if words[:1] == ["server"] and words[1] != "{":
                line = line.replace(words[1], next(servers).target)
            lines.append(line)
        text = "\n".join(lines).replace("listen 50051 http2;", "listen %s http2;" % self.target)
        self.config, self.log = os.path.join(folder, "nginx.conf"), os.path.join(folder, "nginx.log")
        with open(self.config, "w") as config:
            config.write(text)
        self.process = subprocess.Popen([nginx_program(), "-e", self.log, "-p", folder, "-c", self.config, "-g",
                                         "daemon off; pid %s/nginx.pid;" % folder], stderr=subprocess.DEVNULL)

    @property
    def target(self):
        return "127.0.0.1:%d" % self.port


class Prometheus(Stopped):
    """The rules of deploy/grafana over what is scraped each second."""

    def __init__(self, folder, targets):
        self.port = free_port()
        rules = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "grafana", "alerts.yml")
        config = os.path.join(folder, "prometheus.yml")
        with open(config, "w") as out:
            out.write("global: {scrape_interval: 1s}\nrule_files: [%s]\nscrape_configs:\n" % os.path.abspath(rules))
            for job, ports in targets.items():
                out.write("  - job_name: %s\n    static_configs: [{targets: [%s]}]\n" % (
                    job, ", ".join('"127.0.0.1:%d"' % p for p in ports)))
        self.process = subprocess.Popen(["prometheus", "--config.file=" + config, "--storage.tsdb.path=" + os.path.join(folder, "tsdb"),
                                         "--web.listen-address=127.0.0.1:%d" % self.port, "--log.level=error"],
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    def ask(self, what):
        """The values of an instant query, by instance; empty: it does not answer yet."""
        address = "http://127.0.0.1:%d/api/v1/query?query=%s" % (self.port, urllib.parse.quote(what))
        try:
            with urllib.request.urlopen(address, timeout=5) as answer:
                found = json.load(answer)["data"]["result"]
        except (OSError, ValueError):
            return {}
        return {r["metric"].get("instance", ""): float(r["value"][1]) for r in found}


class Wire:
    """Passes bytes on to a port until it is cut: nothing arrives any more, and nobody is told."""

    def __init__(self, port):
        self.to, self.cut = port, False
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self):
        while True:
            try:
                one, _ = self.listener.accept()
                two = socket.create_connection(("127.0.0.1", self.to))
            except OSError:
                return
            for a, b in ((one, two), (two, one)):
                threading.Thread(target=self._pass, args=(a, b), daemon=True).start()

    def _pass(self, a, b):
        try:
            while data := a.recv(65536):
                while self.cut:
                    time.sleep(0.05)
                b.sendall(data)
        except OSError:
            pass
        for s in (a, b):
            try:
                s.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass
