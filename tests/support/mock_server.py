"""Running programs that serve, for tests in Python: `sys.path` needs this folder."""
import subprocess
import threading


class Served:
    """A program that says `marker` and then the address that it serves on. address: HOST:PORT; metrics_url: None unless it says
    that port, too; said: the lines of its log so far, which is read all the time: a full pipe would stop it."""

    def __init__(self, command, marker):
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        self._marker = marker
        self.address = self.metrics_url = None
        self.said = []
        self._up = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._up.wait(timeout=120)
        if not self.address:
            self.stop()
            raise AssertionError("the program did not come up: " + "".join(self.said))

    def _read(self):
        for line in self.process.stdout:
            self.said.append(line)
            if "metrics on port " in line:
                port = line.split("metrics on port ")[1].strip()
                self.metrics_url = None if port == "0" else "http://127.0.0.1:%s/metrics" % port
            if self._marker in line and not self.address:
                self.address = line.split(self._marker)[1].split(",")[0].strip()
                self._up.set()
        self.process.stdout.close()
        self._up.set()  # it ended before it listened

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        """Kills it; more than once is fine."""
        self.process.kill()
        self.process.wait()
        self._reader.join()

    @property
    def running(self):
        return self.process.poll() is None


class Mock(Served):
    """mock_horopterd, or horopterd. command: as for Popen, where the program needs something around it."""

    def __init__(self, program, *arguments, command=None):
        super().__init__(command or [program, *arguments], "listening on ")
