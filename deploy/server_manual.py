#!/usr/bin/env python3
"""Prints the manual page of horopterd (roff), made of what its --help says.

    server_manual.py HOROPTERD
"""
import re
import subprocess
import sys

HEAD = """.TH HOROPTERD 8
.SH NAME
horopterd \\- recognises known parts in images from uncalibrated cameras
.SH SYNOPSIS
.B horopterd
[OPTIONS]
.SH DESCRIPTION
Serves the catalog and recognition over gRPC until it gets SIGTERM or SIGINT; it then refuses new calls, lets those that run
finish for a while (\\-\\-drain\\-seconds) and ends. A second signal ends it at once; what was acknowledged is on disk.
SIGHUP opens logs, access file and certificates anew.
.PP
Options may stand in a file (\\-\\-config); \\-\\-print\\-config prints one with every option.
.SH OPTIONS
"""
TAIL = """.SH FILES
.TP
/etc/horopter/horopterd.toml
Configuration of the systemd unit horopterd.service.
.TP
/var/lib/horopter
Its state: the catalog, and recordings where they are kept.
.TP
/etc/horopter/keys
Certificate and key, which the unit hands on (/run/credentials/horopterd.service/keys_NAME).
.SH EXIT STATUS
.TP
0
stopped by a signal
.TP
1
it cannot start or go on; the reason is on standard error
.TP
2
wrong usage
.TP
3
it could not reach its own ports any more (\\-\\-self\\-check\\-seconds)
.TP
128 + signal
ended at once by a second signal
.SH SEE ALSO
.BR horopter (1)
"""


def roff(text):
    return re.sub(r"^([.'])", r"\\\\&\1", text.replace("\\", "\\e").replace("-", "\\-"))


def options_of(said):
    """(option, description) as --help lists them: a name, and what follows it, perhaps on further lines."""
    found = []
    for line in said.splitlines():
        begins = re.match(r"^  (-\S.*?)(?:  +(\S.*))?$", line)
        if begins:
            found.append([begins.group(1), begins.group(2) or ""])
        elif found and line.startswith("      "):
            found[-1][1] = (found[-1][1] + " " + line.strip()).strip()
    return found


def main():
    said = subprocess.run([sys.argv[1], "--help"], capture_output=True, text=True, check=True).stdout
    options = options_of(said)
    if len(options) < 5:
        sys.exit("server_manual.py: --help lists no options")
    text = HEAD
    for name, description in options:
        text += ".TP\n.B %s\n%s\n" % (roff(name), roff(description))
    sys.stdout.write(text + TAIL)


if __name__ == "__main__":
    main()
