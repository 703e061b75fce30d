"""A running mock_horopterd, for tests in Python: `sys.path` needs this folder."""
import subprocess
import threading


class Mock:
    """address: HOST:PORT; metrics_url: None unless --metrics-listen is among the arguments; command: as for Popen, where the
    program needs something around it; said: the lines of its log so far, which is read all the time: a full pipe would stop it."""

    def __init__(self, program, *arguments, command=None):
        self.process = subprocess.Popen(command or [program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        text=True)
        self.address = self.metrics_url = None
        self.said = []
        self._up = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._up.wait(timeout=120)
        if not self.address:
            self.stop()
            raise AssertionError("the mock server did not come up: " + "".join(self.said))

    def _read(self):
        for line in self.process.stdout:
            self.said.append(line)
            if "metrics on port " in line:
                port = line.split("metrics on port ")[1].strip()
                self.metrics_url = None if port == "0" else "http://127.0.0.1:%s/metrics" % port
            if "listening on " in line and not self.address:
                self.address = line.split("listening on ")[1].strip()
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
