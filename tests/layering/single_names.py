"""That no two files which are compiled as one (deploy/unity.cmake) give one name to two things of their own.

What only its file sees - in an anonymous namespace, or static or constexpr in a source - may be called as it likes in a
file that is compiled alone. In a batch a second constant or type of its name is an error, and a second function silently
takes calls that its overloads fit better. Text is judged, not what a compiler sees; an alias of the same meaning is none.

    single_names.py SIZE FILE...   prints batches of at most SIZE files, one a line, in which no name is had twice: for tests,
                                   which may name their constants as they like
"""
import collections
import os
import re
import sys

# Files below each of these make the batches of their targets.
FOLDERS = ("server", "db", "client")
NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"|(?<![0-9a-fA-F])\'(?:\\.|[^\'\\\n])+\''
                   r'|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*', re.DOTALL | re.MULTILINE)
NAMESPACE = re.compile(r"\bnamespace\b\s*([\w:]*)\s*$")
TYPE = re.compile(r"^(?:template\s*<.*>\s*)?(?:struct|class|enum(?:\s+(?:class|struct))?|union)\s+([A-Za-z_]\w*)\s*"
                  r"(?:final\b\s*)?(?::(?!:).*)?$", re.DOTALL)
ALIAS = re.compile(r"^(?:using|namespace)\s+([\w:]+)\s*(?:=|$)")
CONSTANT = re.compile(r"\b(k[A-Z]\w*)\s*(?:\[[^\]]*\]\s*)*(?:=|\{|$)")
FUNCTION = re.compile(r"([A-Za-z_]\w*)\s*\($")
LOCAL = re.compile(r"(?m)^[ \t]+(?:static )?constexpr\b[^\n]*?\b(k[A-Z]\w*)\s*(?:\[[^\]]*\]\s*)*[={]")
INCLUDE = re.compile(r'(?m)^[ \t]*#[ \t]*include[ \t]+"([^"]+)"')
VARIABLE = re.compile(r"[\w>&*\]]\s+[&*]*([A-Za-z_]\w*)\s*(?:\[[^\]]*\]\s*)*$")


def statements(text):
    """(namespaces around it, text up to its body or initialiser, line, whether a body follows) of what stands in namespaces."""
    text = NOISE.sub(lambda match: re.sub(r"[^\n]", " ", match.group(0)), text)
    scopes, start, depth, head = [], 0, 0, None
    for match in re.finditer(r"[{}();]", text):
        c = match.group(0)
        if c in "()":
            depth += (c == "(") - (c == ")")
        elif c == "{":
            before = text[start:match.start()]
            namespace = NAMESPACE.search(before) if head is None and depth == 0 else None
            if namespace:
                scopes.append(namespace.group(1))
                start = match.end()
            else:
                if head is None and depth == 0:  # no default argument
                    head = (before, match.start())
                scopes.append(None)
        elif c == "}":
            kind = scopes.pop() if scopes else None
            if None in scopes or depth:
                continue
            if kind is not None:
                start, head = match.end(), None
            elif head and re.search(r"\)[^=]*$", head[0], re.DOTALL) and "=" not in head[0].split("(")[0]:
                # The body of a function: no semicolon follows.
                yield list(scopes), head[0].strip(), text.count("\n", 0, head[1]) + 1, True
                start, head = match.end(), None
        elif depth == 0 and None not in scopes:
            before, where = head or (text[start:match.start()], match.start())
            yield list(scopes), (before if head else before).strip(), text.count("\n", 0, where) + 1, head is not None
            start, head = match.end(), None


def names(statement, body):
    """The names that a statement of a namespace defines, and whether it is an alias."""
    alias = ALIAS.match(statement)
    if alias:
        return [alias.group(1).rsplit("::", 1)[-1]], True
    if body and TYPE.match(statement):
        return [TYPE.match(statement).group(1)], False
    plain = re.sub(r"^template\s*<[^()]*>\s*(?=[\w:])", "", statement)
    initial = plain.split("=")[0]
    if "(" in initial and not CONSTANT.search(initial.split("(")[0] + "$"):
        found = FUNCTION.search(initial[:initial.index("(") + 1])
        # What is only declared comes again where it is defined.
        return ([found.group(1)] if found and body else []), False
    # Not what stands in angle brackets or is a value.
    while True:
        less = re.sub(r"<[^<>]*>", "", plain)
        if less == plain:
            break
        plain = less
    # Behind an equals sign a constant at the end is a value.
    constants = [m.group(1) for m in CONSTANT.finditer(plain) if "=" not in plain[:m.start()] or not plain.endswith(m.group(0))]
    if constants:
        return constants, False
    if "=" in plain or body or "(" not in plain:
        found = VARIABLE.search(initial.strip() if "<" not in initial else re.sub(r"<.*>", "", initial.strip()))
        if found and not re.match(r"(template|friend|extern|struct|class|enum|static_assert)\b", plain):
            return [found.group(1)], False
    return [], False


def own_names(path, text):
    """{name: (line, text of an alias or None)} of what only a source file sees; of a header, its constants."""
    out = {}
    for scopes, statement, line, body in statements(text):
        found, alias = names(statement, body)
        if path.endswith(".h"):
            # Types and aliases of the namespace, too: a function of that name would hide them.
            found = [name for name in found if "(" not in statement and not statement.startswith("using Eigen::")]
            alias = False
        elif "" not in scopes and not re.match(r"(static|constexpr|const)\b", statement):
            continue
        elif "" not in scopes and re.match(r"const\b", statement) and "(" in statement.split("=")[0]:
            continue
        for name in found:
            out.setdefault(name, (line, " ".join(statement.split()) if alias else None))
    return out


def scope_of(folder):
    """Folders whose files some target compiles together."""
    return "client" if folder.startswith("client") else folder


def included(paths, includes):
    """All headers of the tree that these files include, also by others."""
    seen, open_ends = set(), list(paths)
    while open_ends:
        for header in includes.get(open_ends.pop(), ()):
            if header not in seen:
                seen.add(header)
                open_ends.append(header)
    return seen


def hidden_in_headers(names_of, includes):
    """Violations: a name of a source's own that a header of another folder has, which a file of the source's folder includes."""
    sources = collections.defaultdict(list)
    for path in names_of:
        if path.endswith(".cc"):
            sources[scope_of(os.path.dirname(path))].append(path)
    found = []
    for folder, paths in sorted(sources.items()):
        of_headers = {}
        for header in sorted(included(paths, includes)):
            if header in names_of and scope_of(os.path.dirname(header)) != folder:
                for name, (line, _) in names_of[header].items():
                    of_headers.setdefault(name, (header, line))
        found += [(path, line, "%s: %s:%d has this name, and a file that may be compiled as one with this one includes it (deploy/unity.cmake)" %
                   (name, *of_headers[name])) for path in paths for name, (line, _) in names_of[path].items() if name in of_headers]
    return found


def check_names(root, folders=FOLDERS):
    """Violations as (path, line, text)."""
    known = collections.defaultdict(lambda: collections.defaultdict(list))
    local = []  # (path, line, name) of constants in functions: they would hide one of the folder
    names_of, includes = {}, {}
    for top in folders:
        for where, inner, files in os.walk(os.path.join(root, top)):
            inner.sort()
            for name in sorted(files):
                path = os.path.relpath(os.path.join(where, name), root)
                if not name.endswith((".cc", ".h")) or name == "main.cc":
                    continue
                with open(os.path.join(root, path), encoding="utf-8") as source:
                    text = source.read()
                names_of[path], includes[path] = own_names(path, text), INCLUDE.findall(text)
                for own, (line, alias) in names_of[path].items():
                    known[scope_of(os.path.dirname(path))][own].append((path, line, alias))
                if path.endswith(".cc"):
                    local += [(path, text.count("\n", 0, m.start(1)) + 1, m.group(1)) for m in LOCAL.finditer(text)]
    found = [(path, line, "%s: hides what %s:%d has under this name, and both may be compiled as one (deploy/unity.cmake)" %
              (own, *known[scope_of(os.path.dirname(path))][own][0][:2]))
             for path, line, own in local if own in known[scope_of(os.path.dirname(path))]]
    found += hidden_in_headers(names_of, includes)
    for of_folder in known.values():
        for own, places in of_folder.items():
            first = places[0]
            for path, line, alias in places[1:]:
                if path.endswith(".h") and first[0].endswith(".h"):
                    continue
                if alias is None or alias != first[2]:
                    found.append((path, line, "%s: %s:%d has something of its own of this name, and both may be compiled as one "
                                  "(deploy/unity.cmake): share it or give it a name that says what it is of" %
                                  (own, first[0], first[1])))
    return sorted(found)


# Macros of GoogleTest look like functions.
TESTS = re.compile(r"(TYPED_)?(TEST(_F|_P|_SUITE\w*)?|INSTANTIATE_\w+)$")


def batches(size, files):
    """Lists of files; each comes into the first in which nothing else has a name of its own."""
    found = []  # (files, {name: text of an alias or None})
    for path in files:
        with open(path, encoding="utf-8") as source:
            own = {name: alias for name, (_, alias) in own_names(path, source.read()).items() if not TESTS.match(name)}
        for members, taken in found:
            if len(members) < size and all(name not in taken or (alias and alias == taken[name]) for name, alias in own.items()):
                members.append(path)
                taken.update(own)
                break
        else:
            found.append(([path], own))
    return [members for members, _ in found]


if __name__ == "__main__":
    for members in batches(int(sys.argv[1]), sys.argv[2:]):
        print(" ".join(members))
