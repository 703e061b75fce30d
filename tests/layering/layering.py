#!/usr/bin/env python3
"""Checks every #include of the sources against the layers of the architecture, that no two files define a type of one
name in one namespace, that a file includes the modules of Eigen that it uses, and that no two files of a target have a
name of their own in common (single_names.py).

    layering.py [ROOT]        prints one line per violation; exit 0 none, 1 some, 2 nothing to check

What may include what is data, at the top of this file: FOLDERS for the project's own headers, LIBRARIES for everybody
else's, EXCEPTIONS for what breaks a rule on purpose. A folder, a library or a system header nobody has placed yet is a
violation too, so that a new one gets its rule on the day it appears.
"""
import collections
import os
import re
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import single_names  # noqa: E402

# The rooms of recognition, in the order of the dependency.
ROOMS = ["aspects", "aspect_search", "aspect_scenes", "object", "invariant_matching", "initialization", "interpretation"]
ROOMS_SHARE = ["server/vision/recognition/types.h", "server/vision/recognition/options.h",
               "server/vision/recognition/learnt_constants.h", "server/vision/recognition/acceptance.h",
               "server/vision/recognition/refusals.h"]
BELOW_ROOMS = ["server/base", "server/vision/geometry", "server/vision/invariants", "server/vision/features",
               "server/vision/matching", "server/vision/reconstruction"]

# Folder -> folders whose headers it may include, besides its own. In the order of the dependency: a folder may only name
# folders above it. `server/main.cc` and its flags are files that are layers of their own.
FOLDERS = collections.OrderedDict([
    ("server/base", []),
    ("server/index", ["server/base"]),
    ("server/vision/geometry", ["server/base"]),
    # Lines and texts over images, for the server's answers and the client's pictures.
    ("server/overlay", ["server/base", "server/vision/geometry"]),
    # Keys of vertices and lines: pure functions of coordinates, beside the stages.
    ("server/vision/invariants", ["server/base", "server/vision/geometry"]),
    ("server/vision/features", ["server/base", "server/vision/geometry"]),
    ("server/vision/matching", ["server/base", "server/vision/geometry", "server/vision/features"]),
    ("server/vision/reconstruction",
     ["server/base", "server/vision/geometry", "server/vision/features", "server/vision/matching"]),
    # What all rooms of recognition share, then the rooms in their order, then the page that calls them.
    ("server/vision/recognition/types.h", ["server/base", "server/vision/geometry"]),
    ("server/vision/recognition/learnt_constants.h", []),
    ("server/vision/recognition/acceptance.h", ["server/vision/recognition/learnt_constants.h"]),
    ("server/vision/recognition/options.h", ["server/base", "server/vision/recognition/acceptance.h",
                                             "server/vision/recognition/learnt_constants.h"]),
    ("server/vision/recognition/refusals.h", ["server/base", "server/vision/recognition/types.h"]),
] + [
    ("server/vision/recognition/" + room, BELOW_ROOMS + ROOMS_SHARE + ["server/vision/recognition/" + r for r in ROOMS[:i]])
    for i, room in enumerate(ROOMS)
] + [
    ("server/vision/recognition", BELOW_ROOMS + ROOMS_SHARE + ["server/vision/recognition/" + r for r in ROOMS]),
    ("server/vision/euclidean",
     BELOW_ROOMS + ROOMS_SHARE + ["server/vision/recognition"] + ["server/vision/recognition/" + r for r in ROOMS]),
    # What is known of a cell's cameras from request to request: above the adjustment it learns from.
    ("server/vision/station",
     ["server/base", "server/vision/geometry", "server/vision/recognition", "server/vision/euclidean",
      "server/vision/recognition/types.h"]),
    # Reads what recognition and the adjustment found, and changes none of it.
    ("server/vision/explanation",
     BELOW_ROOMS + ROOMS_SHARE + ["server/vision/recognition", "server/vision/euclidean"] +
     ["server/vision/recognition/" + r for r in ROOMS]),
    # The catalog stores value types, which all live in geometry; it knows no stage.
    ("db", ["server/base", "server/vision/geometry"]),
    ("proto", []),
    ("server/pipeline",
     ["server/base", "db", "server/vision/geometry", "server/vision/features", "server/vision/matching",
      "server/vision/reconstruction", "server/vision/recognition", "server/vision/euclidean",
      "server/vision/explanation", "server/vision/station"] + ROOMS_SHARE +
     # Stored objects, the catalog's keys, and the options that variants of the methods change.
     ["server/vision/recognition/object", "server/vision/recognition/invariant_matching",
      "server/vision/recognition/initialization"]),
    # Handlers convert and call: they see the pipeline and value types, no stage.
    ("server/service",
     ["server/base", "db", "proto", "server/overlay", "server/vision/geometry", "server/vision/invariants",
      "server/pipeline"]),
    # Configuration files, of the server and of the console.
    ("server/checked_config.h", []),
    ("server/checked_config.cc", ["server/checked_config.h"]),
    ("server/flags.h", ["server/service"]),
    ("server/flags.cc", ["server/service", "server/flags.h", "server/checked_config.h"]),
    ("server/main.cc", ["server/base", "db", "proto", "server/pipeline", "server/service", "server/flags.h"]),
    # The client talks to the server over the wire; it shares value types and the status macros.
    ("client", ["server/base", "proto", "server/overlay", "server/vision/geometry"]),
    # A process of its own that passes calls on; it knows no message.
    ("console", ["server/base", "client", "server/checked_config.h"]),
    ("console/main.cc", ["client", "console"]),
])

# Rooms that ask the index.
INDEX_USERS = ["server/vision/recognition/aspects", "server/vision/recognition/invariant_matching"]
for _room in INDEX_USERS:
    FOLDERS[_room] = FOLDERS[_room] + ["server/index"]

STAGES = ["server/vision/features", "server/vision/matching", "server/vision/reconstruction",
          "server/vision/recognition", "server/vision/euclidean"]
VISION = ["server/vision/geometry", "server/vision/invariants"] + STAGES
EVERYWHERE = list(FOLDERS)
EDGE = ["server/service", "server/main.cc", "client", "console", "console/main.cc"]

# Library -> (pattern of its headers, folders that may include them).
LIBRARIES = collections.OrderedDict([
    ("Protobuf", (r"google/protobuf/|google/rpc/", EDGE + ["proto"])),
    ("gRPC", (r"grpc/|grpcpp/|grpc\+\+/", EDGE + ["proto"])),
    ("SQLite", (r"sqlite3(ext)?\.h$", ["db"])),
    ("PostgreSQL", (r"libpq-fe\.h$", ["db"])),
    # Everybody below may forward-declare cv::Mat and pass it on; these look into images.
    ("OpenCV umbrella header", (r"opencv2/opencv\.hpp$", [])),
    ("OpenCV core", (r"opencv2/core(\.hpp$|/)",
                     ["server/vision/features", "server/vision/matching", "server/pipeline", "server/service",
                      "server/overlay", "client"])),
    ("OpenCV image files", (r"opencv2/imgcodecs(\.hpp$|/)", ["client"])),
    ("image formats", (r"(jpeglib|jerror|png|tiffio)\.h$|webp/|libheif/", ["server/service"])),
    ("OpenCV", (r"opencv2/", ["server/vision/features", "server/vision/matching", "server/overlay", "client"])),
    ("Eigen's solvers", (r"unsupported/Eigen/NonLinearOptimization$", ["server/vision/geometry"])),
    ("Ceres", (r"ceres/", STAGES + ["server/vision/geometry"])),
    ("OpenCASCADE", (r"[A-Za-z0-9]+_?[A-Za-z0-9_]*\.hxx$", ["client"])),
    ("zlib", (r"zlib\.h$", ["client", "console"])),
    ("Boost", (r"boost/(asio|beast|system)[./]", ["console", "console/main.cc"])),
    ("yaml-cpp", (r"yaml-cpp/", ["client"])),
    ("CLI11", (r"CLI/", ["server/flags.h", "server/flags.cc", "server/checked_config.h", "server/checked_config.cc",
                          "server/main.cc", "client", "console", "console/main.cc"])),
    ("Prometheus", (r"prometheus/", ["server/service", "console"])),
    ("spdlog", (r"spdlog/|fmt/", EDGE)),
    ("JSON", (r"nlohmann/", EDGE)),
    ("glog", (r"glog/", ["server/main.cc"])),
    ("vector instructions", (r"immintrin\.h$", ["server/index"])),
    ("Eigen", (r"Eigen/", EVERYWHERE)),
    ("Abseil", (r"absl/", EVERYWHERE)),
    # No stage reads a file or a clock, and none prints.
    ("files, clocks and streams of the standard library",
     (r"(fstream|filesystem|iostream|chrono|ctime|time\.h|sys/time\.h)$",
      ["db", "server/pipeline", "server/service", "server/flags.cc", "server/checked_config.cc", "server/main.cc", "client",
       "console", "console/main.cc"])),
    # Work is shared out by ParallelFor, within the budget of a request; only the service keeps threads of its own.
    ("threads", (r"(thread|future)$", ["server/base", "server/service", "server/main.cc", "client"])),
    ("TLS", (r"openssl/", ["server/service", "console"])),
    ("systemd", (r"systemd/", ["server/main.cc", "console/main.cc"])),
    ("heap of the C library", (r"malloc\.h$", ["server/pipeline"])),  # beside what else is set for the whole process
    ("operating system", (r"(unistd|fcntl|signal|dirent|poll|pthread|spawn|dlfcn|netdb)\.h$|csignal$|(sys|netinet|arpa|linux)/",
                          ["db", "server/service", "server/main.cc", "client", "console", "console/main.cc"])),
])
ONLY_IN_SOURCES = ["Ceres"]  # too heavy for our headers

# (file or folder, library or folder, why). The only place where a rule may be broken.
EXCEPTIONS = [
    ("client/image_size.cc", "image formats", "the size of a HEIC image, which OpenCV does not read"),
    ("server/service/raw_frame.cc", "OpenCV", "mosaics and colour spaces of raw frames"),
    ("server/service/image_preview.cc", "OpenCV", "small pictures for people are averages of pixels"),
    ("server/vision/recognition/interpretation", "OpenCV core", "the aspects' route reads the request's images"),
    ("server/vision/recognition/scene", "OpenCV core", "texture on faces is read from the request's images"),
    ("server/vision/recognition/scene", "OpenCV", "texture on faces is compared in rectified patches"),
    ("server/vision/recognition/aspects", "OpenCV core", "aspects are compared with the pixels of the request's images"),
    ("server/vision/recognition/aspects", "OpenCV", "oriented distance maps of the images"),
    ("server/vision/euclidean", "OpenCV core", "refinement looks for edge points along the normals in the images"),
    ("server/vision/reconstruction/bundle_manifolds.h", "Ceres", "manifolds and losses that both adjustments share"),
    ("server/vision/euclidean/scene_costs.h", "Ceres", "cost functors split off euclidean.cc, their only user"),
]

# What needs a module of Eigen beside Eigen/Core. Without the include it compiles only where the precompiled headers, or
# another header by chance, bring it along.
EIGEN_MODULES = collections.OrderedDict([
    ("Geometry", r"[.>](?:homogeneous|hnormalized|cross|cross3|unitOrthogonal|eulerAngles)\s*\(|"
                 r"\bEigen::(?:Quaternion|AngleAxis|Isometry|Affine|Projective|Transform|Translation|Rotation2D|"
                 r"AlignedBox|Hyperplane|ParametrizedLine|Scaling)|\bEigen::umeyama"),
    ("SVD", r"\bEigen::(?:JacobiSVD|BDCSVD)"),
    ("Cholesky", r"\bEigen::(?:LLT|LDLT)|[.>](?:llt|ldlt)\s*\("),
    ("QR", r"\bEigen::(?:HouseholderQR|ColPivHouseholderQR|FullPivHouseholderQR|CompleteOrthogonal)|"
           r"[.>](?:householderQr|colPivHouseholderQr|fullPivHouseholderQr)\s*\("),
    ("LU", r"\bEigen::(?:PartialPivLU|FullPivLU)|[.>](?:partialPivLu|fullPivLu|inverse|determinant)\s*\("),
    ("Eigenvalues", r"\bEigen::(?:SelfAdjointEigenSolver|EigenSolver|GeneralizedSelfAdjointEigenSolver|"
                    r"ComplexEigenSolver)|[.>]eigenvalues\s*\("),
])
# What Eigen's own headers bring along.
EIGEN_BRINGS = {"Dense": list(EIGEN_MODULES), "Eigenvalues": ["Cholesky", "LU", "Geometry", "QR"],
                "Geometry": ["SVD", "LU", "QR"], "SVD": ["QR"], "QR": ["Cholesky"]}
EIGEN_INCLUDE = re.compile(r"^\s*#\s*include\s*<Eigen/(\w+)>", re.MULTILINE)

STANDARD = re.compile(r"[a-z0-9_]+$|(std(int|lib|io|def)|string|math|assert|errno|limits|float)\.h$")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^">]+)[">]')
SOURCES = (".h", ".cc")


def folder_of(path):
    """The layer a file of the project belongs to, or None."""
    if path in FOLDERS:
        return path
    best = None
    for folder in FOLDERS:
        if path.startswith(folder + "/") and (best is None or len(folder) > len(best)):
            best = folder
    # A file directly in server/, or in a folder without a rule, belongs nowhere.
    return best


def library_of(header):
    for name, (pattern, _) in LIBRARIES.items():
        if re.match(pattern, header):
            return name
    return None


def excepted(path, folder, what):
    return any(what == allowed and where in (path, folder) for where, allowed, _ in EXCEPTIONS)


def check_include(root, path, folder, quote, header):
    """Returns why the include breaks a rule, or None."""
    generated = re.match(r"horopter/v\d+/\w+(\.grpc)?\.pb\.h$", header)
    if generated:
        target = "proto"
    elif header.startswith(("server/", "db/", "client/", "console/", "proto/", "tests/")):
        if quote == "<":
            return "the project's own headers are included with quotes"
        if not os.path.exists(os.path.join(root, header)):
            return "no such file"
        target = folder_of(header)
        if target is None:
            return "is in no known layer"
    else:
        target = None
    if target is not None:
        if target == folder or target in FOLDERS[folder] or excepted(path, folder, target):
            return None
        return "%s may not include %s" % (folder, target)

    library = library_of(header)
    if library is not None:
        allowed = LIBRARIES[library][1]
        if folder not in allowed and not excepted(path, folder, library):
            return "%s may not include %s" % (folder, library)
        # An exception for a folder does not open its headers: each such header is named by itself.
        if library in ONLY_IN_SOURCES and path.endswith(".h") and not excepted(path, path, library):
            return "%s only in .cc files" % library
        return None
    if quote == '"':
        return "include from the root of the project (or name the library in LIBRARIES)"
    if not STANDARD.match(header):
        return "unknown library: name it in LIBRARIES"
    return None


def check_file(root, path):
    folder = folder_of(path)
    if folder is None:
        return [(path, 1, "is in no known layer: give it a rule in FOLDERS")]
    found = []
    with open(os.path.join(root, path), encoding="utf-8") as source:
        for number, line in enumerate(source, 1):
            match = INCLUDE.match(line)
            if not match:
                continue
            why = check_include(root, path, folder, match.group(1), match.group(2))
            if why:
                found.append((path, number, "%s: %s" % (match.group(2), why)))
    return found


def sources(root, tops=("server", "db", "client", "console", "proto")):
    for top in tops:
        for where, folders, files in os.walk(os.path.join(root, top)):
            folders.sort()
            for name in sorted(files):
                if name.endswith(SOURCES):
                    yield os.path.relpath(os.path.join(where, name), root)

# What a twin is searched with: comments, literals and preprocessor lines hold no definition.
NOISE = re.compile(r'//[^\n]*|/\*.*?\*/|R"(\w*)\(.*?\)\1"|"(?:\\.|[^"\\\n])*"|(?<![0-9a-fA-F])\'(?:\\.|[^\'\\\n])+\''
                   r'|^[ \t]*#(?:[^\n]*\\\n)*[^\n]*', re.DOTALL | re.MULTILINE)
TYPE = re.compile(r"\b(?:struct|class|enum(?:\s+(?:class|struct))?|union)\s+(?:\[\[[^\]]*\]\]\s*|alignas\s*\([^)]*\)\s*)*"
                  r"([A-Za-z_]\w*)\s*(?:final\b\s*)?(?::(?!:)[^{};]*)?$")
ALIAS = re.compile(r"\busing\s+([A-Za-z_]\w*)\s*=|\btypedef\b.*?\b([A-Za-z_]\w*)\s*$", re.DOTALL)
NAMESPACE = re.compile(r"\bnamespace\b\s*([\w:]*)\s*$")


def types_of(text):
    """The types a file defines in a namespace with a name, as (qualified name, line)."""
    text = NOISE.sub(lambda match: re.sub(r"[^\n]", " ", match.group(0)), text)
    found = []
    scopes = []  # per open brace: the namespace's name, "" for one without, None for anything else
    start = 0    # of the statement that is being read

    def add(name, where):
        if None not in scopes and "" not in scopes:
            found.append(("::".join(scopes + [name]), text.count("\n", 0, where) + 1))

    for brace in re.finditer(r"[{};]", text):
        statement = text[start:brace.start()]
        if brace.group(0) == "{":
            namespace = NAMESPACE.search(statement)
            defined = TYPE.search(statement)
            if defined:
                add(defined.group(1), start + defined.start(1))
            scopes.append(namespace.group(1) if namespace else None)
        elif brace.group(0) == "}":
            if scopes:
                scopes.pop()
        else:
            alias = ALIAS.search(statement)
            if alias:
                group = 1 if alias.group(1) else 2
                add(alias.group(group), start + alias.start(group))
        start = brace.end()
    return found


def check_types(root):
    """Two definitions of one name in one namespace are undefined behaviour, even in files that never meet in a
    translation unit: the linker keeps one of each inline function and of each template made from the two."""
    first = {}
    found = []
    for path in sources(root, ("server", "db", "client", "console", "tests")):
        with open(os.path.join(root, path), encoding="utf-8") as source:
            for name, line in types_of(source.read()):
                known = first.setdefault(name, path)
                if known != path:
                    found.append((path, line, "%s: %s defines a type of this name, too" % (name, known)))
    return found


def eigen_modules_of(root, path):
    """Eigen's modules that a file includes, or its own header does."""
    modules = set()
    for name in (path, os.path.splitext(path)[0] + ".h"):
        full = os.path.join(root, name)
        if os.path.exists(full):
            with open(full, encoding="utf-8") as source:
                modules.update(EIGEN_INCLUDE.findall(source.read()))
    for module in ("Dense", "Eigenvalues", "Geometry", "SVD", "QR"):  # each brings what stands behind it
        if module in modules:
            modules.update(EIGEN_BRINGS[module])
    return modules


def check_eigen(root):
    """A file that uses a module of Eigen includes it, or its own header does."""
    found = []
    for path in sources(root, ("server", "db", "client", "console", "tests")):
        with open(os.path.join(root, path), encoding="utf-8") as source:
            text = source.read()
        plain = NOISE.sub(lambda match: re.sub(r"[^\n]", " ", match.group(0)), text)
        modules = eigen_modules_of(root, path)
        for module, use in EIGEN_MODULES.items():
            match = re.search(use, plain)
            if match and module not in modules:
                found.append((path, plain.count("\n", 0, match.start()) + 1,
                              "%s: include <Eigen/%s>" % (match.group(0).strip(".>( "), module)))
    return found


def check_table():
    """The table itself: folders name only folders above them, exceptions name real things."""
    found = []
    seen = set()
    for folder, allowed in FOLDERS.items():
        found += ["%s names %s, which is not above it" % (folder, a) for a in allowed if a not in seen]
        seen.add(folder)
    for where, what, why in EXCEPTIONS:
        if folder_of(where) is None or (what not in LIBRARIES and what not in FOLDERS) or not why:
            found.append("exception (%s, %s) names nothing or gives no reason" % (where, what))
    return found


def check_tree(root):
    """All violations below root as (path, line, text), and the number of files read."""
    paths = list(sources(root))
    found = []
    for path in paths:
        found += check_file(root, path)
    return found + check_types(root) + check_eigen(root) + single_names.check_names(root), len(paths)


def main():
    root = sys.argv[1] if len(sys.argv) > 1 else os.path.join(os.path.dirname(__file__), "..", "..")
    table = check_table()
    found, count = check_tree(root)
    for text in table:
        print("layering.py: " + text)
    for path, line, text in found:
        print("%s:%d: %s" % (path, line, text))
    print("%d files, %d violations" % (count, len(found) + len(table)))
    if count == 0:
        return 2
    return 1 if found or table else 0


if __name__ == "__main__":
    sys.exit(main())
