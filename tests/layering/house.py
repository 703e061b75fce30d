#!/usr/bin/env python3
"""Figures of the house: how large rooms and functions are, which rooms know which, and how much of the options one tree reaches.

    house.py [ROOT]

Counts text, not what a compiler sees: a function is a block after a parameter list outside of any other, its lines go from its
first word to its closing brace; an options struct is one whose name ends in Options, Acceptance or Routes.
"""
import collections
import os
import re
import sys

LONG = 60  # lines of a function that is long
ROOMS = "server/vision/recognition"
# Trees of options: of a request, of the server. What the catalog stores of a part is fixed by its format, and no tree has it.
OPTION_ROOTS = ["PipelineOptions", "ServerOptions"]
FUNCTIONS_IN = ["server", "client", "db"]
MATHEMATICAL = ["kPi", "kHalfPi", "kTwoPi", "kDegrees", "kInfinity"]  # constants that need no reason
OPTIONS = re.compile(r"\bstruct (\w*(?:Options|Acceptance|Routes))\b[^{;]*\{")


def sources(root, folders):
    for folder in folders:
        for path, _, names in os.walk(os.path.join(root, folder)):
            for name in sorted(names):
                if name.endswith((".h", ".cc")):
                    yield os.path.join(path, name)


def code_of(path):
    """The text without comments, strings and preprocessor lines; lines stay where they are."""
    with open(path, encoding="utf-8") as file:
        text = file.read()

    def blank(match):
        found = match.group(0)
        return "\n" * found.count("\n") if found[0] in "/#" else '""'

    text = re.sub(r'R"\((?:.|\n)*?\)"|//[^\n]*|/\*(?:.|\n)*?\*/|"(?:\\.|[^"\\\n])*"|\'(?:\\.|[^\'\\\n])\'(?![0-9])', blank, text)
    return re.sub(r"(?m)^[ \t]*#(?:\\\n|[^\n])*", blank, text)


def functions(text):
    """Lines of each function and the text before its body."""
    stack, last, line, brackets = [], 0, 1, 0
    for i, c in enumerate(text):
        line += c == "\n"
        brackets += (c == "(") - (c == ")")
        if c == "{":
            before = text[last:i].strip()
            outside = all(kind == "scope" for kind, _, _ in stack)
            kind = "other"
            if outside and brackets == 0:
                if re.match(r"(inline )?namespace\b|extern\b", before):
                    kind = "scope"
                elif re.search(r"\b(class|struct|union)\b", before) and "(" not in before:
                    kind = "scope"
                elif "(" in before and not before.endswith("=") and not re.search(r"\)\s*:[^:].*\w$", before, re.S):
                    kind = "function"
            stack.append((kind, line - text[last:i].lstrip().count("\n"), before))
            if kind != "other":
                last = i + 1
        elif c == "}" and stack:
            kind, first, before = stack.pop()
            if kind == "function":
                yield line - first + 1, " ".join(before.split())
            if all(k == "scope" for k, _, _ in stack):
                last = i + 1
        elif c == ";" and brackets == 0 and all(kind == "scope" for kind, _, _ in stack):
            last = i + 1


def print_functions(root):
    found = [(lines, os.path.relpath(path, root), name)
             for path in sources(root, FUNCTIONS_IN) for lines, name in functions(code_of(path))]
    long = sorted((f for f in found if f[0] > LONG), reverse=True)
    print("functions: %d, longer than %d lines: %d" % (len(found), LONG, len(long)))
    for lines, path, name in long:
        print("  %d %s: %s" % (lines, path, name[:80]))


def bare_constants(path):
    """How many named constants a file has, and the lines of those that no comment explains: neither their own line nor one
    above them or above the constants just before them. Those of mathematics explain themselves."""
    with open(path, encoding="utf-8") as file:
        lines = file.read().split("\n")
    count, bare = 0, []
    for i, line in enumerate(lines):
        named = re.match(r"\s*(static |inline )*constexpr\b.*?\b(k[A-Z]\w*)\s*[={\[]", line)
        if not named or named.group(2) in MATHEMATICAL:
            continue
        count += 1
        end = i
        while ";" not in lines[end] and end < min(i + 4, len(lines) - 1):
            end += 1
        above = i - 1
        while above >= 0 and "constexpr" in lines[above] and "//" not in lines[above]:
            above -= 1
        explained = any("//" in x for x in lines[i:end + 1]) or (above >= 0 and lines[above].lstrip().startswith("//"))
        if not explained:
            bare.append(i + 1)
    return count, bare


def print_constants(root):
    found = {path: bare_constants(path) for path in sources(root, ["server/vision"])}
    print("constants of server/vision: %d, without a comment: %d" %
          (sum(count for count, _ in found.values()), sum(len(bare) for _, bare in found.values())))


def print_rooms(root):
    home = os.path.join(root, ROOMS)
    rooms = sorted(name for name in os.listdir(home) if os.path.isdir(os.path.join(home, name)))
    arrows = collections.Counter()
    print("rooms: %d" % len(rooms))
    for room in rooms:
        files = [f for f in os.listdir(os.path.join(home, room)) if f.endswith((".h", ".cc"))]
        lines = 0
        for name in files:
            with open(os.path.join(home, room, name), encoding="utf-8") as file:
                text = file.read()
            lines += text.count("\n")
            for other in re.findall(r'#include "%s/(\w+)/' % ROOMS, text):
                arrows[(room, other)] += other != room
        print("  %s: %d modules, %d lines" % (room, len({f.rsplit(".", 1)[0] for f in files}), lines))
    known = sorted(pair for pair, count in arrows.items() if count)
    print("arrows between rooms: %d, includes: %d" % (len(known), sum(arrows.values())))
    for pair in known:
        print("  %s -> %s" % pair)


def print_options(root):
    structs, of_rooms = {}, set()
    for path in sources(root, ["server"]):
        text = code_of(path)
        for match in OPTIONS.finditer(text):
            end, depth = match.end(), 1
            while depth:
                depth += (text[end] == "{") - (text[end] == "}")
                end += 1
            fields = []
            for statement in re.sub(r"\{[^{}]*\}", ";", text[match.end():end - 1]).split(";"):
                statement = " ".join(statement.split()).split("=")[0].strip()
                field = re.match(r"([\w:<>, ]+?)[ &*]+(\w+)$", statement)
                if field and not statement.startswith(("static", "using", "struct", "enum")):
                    fields.append(field.group(1))
            structs[match.group(1)] = fields
            if os.path.relpath(path, root).startswith(ROOMS):
                of_rooms.add(match.group(1))
    count = {name: sum(kind not in structs for kind in fields) for name, fields in structs.items()}
    print("options: %d structs, %d fields" % (len(structs), sum(count.values())))
    print("  in %s: %d structs, %d fields" % (ROOMS, len(of_rooms), sum(count[n] for n in of_rooms)))
    left = set(structs)
    for root in OPTION_ROOTS:
        reached, waiting = set(), [root]
        while waiting:
            name = waiting.pop()
            if name in structs and name not in reached:
                reached.add(name)
                waiting.extend(structs[name])
        left -= reached
        print("  reached from %s: %d structs, %d fields" % (root, len(reached), sum(count[n] for n in reached)))
    print("  by none of these: %d structs, %d fields: %s" % (len(left), sum(count[n] for n in left), ", ".join(sorted(left))))


if __name__ == "__main__":
    ROOT = sys.argv[1] if len(sys.argv) > 1 else "."
    print_functions(ROOT)
    print_rooms(ROOT)
    print_options(ROOT)
    print_constants(ROOT)
