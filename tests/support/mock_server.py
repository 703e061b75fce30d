"""A running mock_horopterd, for tests in Python: `sys.path` needs this folder."""
import subprocess


class Mock:
    """address: HOST:PORT; metrics_url: None unless --metrics-listen is among the arguments; command: as for Popen, where the
    program needs something around it."""

    def __init__(self, program, *arguments, command=None):
        self.process = subprocess.Popen(command or [program, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                        text=True)
        self.address = self.metrics_url = None
        for line in self.process.stdout:
            if "metrics on port " in line:
                port = line.split("metrics on port ")[1].strip()
                self.metrics_url = None if port == "0" else "http://127.0.0.1:%s/metrics" % port
            if "listening on " in line:
                self.address = line.split("listening on ")[1].strip()
                break
        assert self.address, "the mock server did not come up"

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def stop(self):
        """Kills it; more than once is fine."""
        self.process.kill()
        self.process.wait()
        self.process.stdout.close()
