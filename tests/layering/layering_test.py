#!/usr/bin/env python3
"""The layering check finds what it is there to find: planted violations in trees made for the purpose."""
import os
import sys
import tempfile
import unittest

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import layering  # noqa: E402


def violations(files, counted=True):
    """Writes files ({path: text}) to a fresh tree and returns {path: [texts]} of what the check says. `counted`: every file
    belongs to a layer, and is read as one."""
    with tempfile.TemporaryDirectory() as root:
        for path, text in files.items():
            full = os.path.join(root, path)
            os.makedirs(os.path.dirname(full), exist_ok=True)
            with open(full, "w", encoding="utf-8") as out:
                out.write(text)
        found, count = layering.check_tree(root)
        assert not counted or count == len([f for f in files if f.endswith(layering.SOURCES)])
        result = {}
        for path, _, text in found:
            result.setdefault(path, []).append(text)
        return result


def one(path, header, others=()):
    """What the check says about one file that includes one header; `others` are files that exist besides."""
    files = {other: "" for other in others}
    files[path] = "#pragma once\n#include %s\n" % header
    return violations(files).get(path, [])


def stage_header(folder):
    return folder + "/" + folder.rsplit("/", 1)[1] + ".h"


class Layering(unittest.TestCase):

    def test_table_is_consistent(self):
        self.assertEqual(layering.check_table(), [])

    def test_a_stage_includes_every_earlier_stage_and_no_later_one(self):
        for i, stage in enumerate(layering.STAGES):
            for j, other in enumerate(layering.STAGES):
                header = stage_header(other)
                said = one(stage + "/x.cc", '"%s"' % header, [header])
                self.assertEqual(said == [], j <= i, "%s including %s said %s" % (stage, other, said))

    def test_a_room_includes_every_lower_room_and_no_higher_one(self):
        rooms = ["server/vision/recognition/" + room for room in layering.ROOMS]
        for i, room in enumerate(rooms):
            for j, other in enumerate(rooms):
                header = stage_header(other)
                said = one(room + "/x.cc", '"%s"' % header, [header])
                self.assertEqual(said == [], j <= i, "%s including %s said %s" % (room, other, said))
            page = "server/vision/recognition/recognition.h"
            self.assertTrue(one(room + "/x.cc", '"%s"' % page, [page]), room)

    def test_geometry_knows_no_stage(self):
        for stage in layering.STAGES:
            header = stage_header(stage)
            self.assertTrue(one("server/vision/geometry/x.h", '"%s"' % header, [header]))

    def test_only_rooms_of_hypotheses_use_the_index(self):
        for folder in layering.FOLDERS:
            if folder == "server/index" or folder.endswith((".cc", ".h")):
                continue
            said = one(folder + "/x.cc", '"server/index/x_tree.h"', ["server/index/x_tree.h"])
            self.assertEqual(said == [], folder in layering.INDEX_USERS, folder)

    def test_only_pipeline_service_and_main_use_the_catalog(self):
        users = {"db", "server/pipeline", "server/service", "server/main.cc"}
        for folder in layering.FOLDERS:
            path = folder if folder.endswith(".cc") else folder + "/x.cc"
            self.assertEqual(one(path, '"db/catalog.h"', ["db/catalog.h"]) == [], folder in users, folder)

    def test_the_catalog_knows_value_types_only(self):
        self.assertEqual(one("db/x.cc", '"server/vision/geometry/rigid3.h"', ["server/vision/geometry/rigid3.h"]), [])
        for folder in layering.STAGES + ["server/pipeline", "server/service"]:
            header = folder + "/x.h"
            self.assertTrue(one("db/x.cc", '"%s"' % header, [header]), folder)

    def test_wire_and_database_stay_at_the_edge(self):
        edge = {"server/service", "server/main.cc", "client", "console", "console/main.cc", "proto"}
        for header in ("<grpcpp/grpcpp.h>", "<google/protobuf/message.h>", '"google/protobuf/util/time_util.h"'):
            for folder in layering.FOLDERS:
                path = folder if folder.endswith(".cc") else folder + "/x.cc"
                self.assertEqual(one(path, header) == [], folder in edge, "%s %s" % (folder, header))
        for folder in layering.FOLDERS:
            path = folder if folder.endswith(".cc") else folder + "/x.cc"
            self.assertEqual(one(path, "<sqlite3.h>") == [], folder == "db", folder)
            generated = one(path, '"horopter/v1/recognition.grpc.pb.h"')
            # The console passes messages on and knows none.
            self.assertEqual(generated == [], folder in edge and not folder.startswith("console"), folder)

    def test_ceres_only_in_sources(self):
        self.assertEqual(one("server/vision/euclidean/x.cc", "<ceres/ceres.h>"), [])
        self.assertTrue(one("server/vision/euclidean/x.h", "<ceres/ceres.h>"))
        self.assertTrue(one("server/pipeline/x.cc", '"ceres/problem.h"'))

    def test_a_header_with_ceres_is_excepted_by_name_only(self):
        named = [where for where, what, _ in layering.EXCEPTIONS if what == "Ceres"]
        self.assertTrue(all(where.endswith(".h") for where in named), named)
        for header in named:
            self.assertEqual(one(header, "<ceres/rotation.h>"), [])
            self.assertTrue(one(header.replace(".h", "_x.h"), "<ceres/rotation.h>"))

    def test_images_are_read_where_the_architecture_says(self):
        self.assertEqual(one("server/vision/features/x.cc", "<opencv2/imgproc.hpp>"), [])
        self.assertEqual(one("server/pipeline/x.h", "<opencv2/core/mat.hpp>"), [])
        self.assertEqual(one("client/x.cc", "<opencv2/imgcodecs.hpp>"), [])
        # The service reads images with their formats' libraries.
        self.assertTrue(one("server/service/x.cc", "<opencv2/imgcodecs.hpp>"))
        for path in ("server/pipeline/x.cc", "server/service/x.cc", "server/vision/reconstruction/x.cc", "db/x.cc"):
            self.assertTrue(one(path, "<opencv2/imgproc.hpp>"), path)
        self.assertTrue(one("server/vision/geometry/x.h", "<opencv2/core.hpp>"))
        for folder in layering.FOLDERS:
            if not folder.endswith(".cc"):
                self.assertTrue(one(folder + "/x.cc", "<opencv2/opencv.hpp>"), folder)

    def test_stages_read_no_file_and_no_clock(self):
        for header in ("<fstream>", "<filesystem>", "<iostream>", "<chrono>", "<ctime>", "<unistd.h>", "<sys/time.h>"):
            for folder in layering.VISION + ["server/base", "server/index"]:
                self.assertTrue(one(folder + "/x.cc", header), folder + header)
            self.assertEqual(one("client/x.cc", header), [])

    def test_stages_start_no_threads(self):
        for header in ("<thread>", "<future>"):
            for folder in layering.VISION + ["server/index", "server/pipeline", "db"]:
                self.assertTrue(one(folder + "/x.cc", header), folder + header)
            self.assertEqual(one("server/base/x.cc", header), [])

    def test_what_nobody_placed_is_a_violation(self):
        self.assertTrue(one("server/robots/x.cc", "<vector>"))
        self.assertTrue(one("server/x.h", "<vector>"))
        self.assertTrue(one("client/x.cc", "<boost/asio.hpp>"))
        self.assertTrue(one("client/x.cc", '"server/vision/geometry/gone.h"'))
        self.assertTrue(one("client/x.cc", '"bop_dataset.h"', ["client/bop_dataset.h"]))
        self.assertTrue(one("client/x.cc", "<server/base/stop_token.h>", ["server/base/stop_token.h"]))

    def test_no_type_name_twice_in_a_namespace(self):
        def twins(first, second, where=("server/vision/features/a.h", "server/vision/recognition/b.h")):
            return bool(violations({where[0]: first, where[1]: second}))

        def within(text):
            return "namespace horopter {\n%s\n}  // namespace horopter\n" % text

        a = within("struct Sample {\n  int x = 0;\n};")
        for b in ("struct Sample {};", "class Sample final : public Base<int> {};", "enum class Sample : int { kA };",
                  "enum Sample { kA };", "using Sample = int;", "typedef int Sample;", "struct [[nodiscard]] Sample {};",
                  "template <typename T>\nstruct Sample {};", "template <typename T> using Sample = T;",
                  "void F() { int x{}; }\nstruct Sample {};", "/* } */ struct Sample {};",
                  "inline const char* s = \"{\";\nstruct Sample {};", "#define OPEN {\nstruct Sample {};"):
            self.assertTrue(twins(a, within(b)), b)
            self.assertTrue(twins(within(b), a), b)
        for b in ("struct Sample;", "struct Other {};", "struct Other { struct Sample { int x; }; };", "Sample Make();",
                  "class Other { using Sample = int; };", "namespace { struct Sample {}; }", "// struct Sample {};",
                  "namespace wire { struct Sample {}; }", "void F() { struct Sample {}; }", "/* struct Sample {}; */",
                  "void F(const struct Sample& s) {}", "template <>\nstruct Hash<Sample> {};", "struct Sample* Make();",
                  "const char* s = \"struct Sample {};\";", "const char* s = R\"(struct Sample {};)\";",
                  "using Other = Sample;", "using wire::Sample;"):
            self.assertFalse(twins(a, within(b)), b)
        # The same name in the same inner namespace, however it is written.
        self.assertTrue(twins("namespace horopter::wire {\nenum class A { kB };\n}\n",
                              within("namespace wire {\nstruct A {};\n}")))

    def test_twins_are_found_in_every_folder_and_in_sources(self):
        text = "namespace horopter {\nstruct Twin {};\n}\n"
        for where in ("server/index/a.h", "server/pipeline/a.cc", "db/a.h", "client/a.cc", "tests/support/a.h",
                      "tests/bench/a.cc"):
            files = {"server/vision/geometry/t.h": text, where: text}
            self.assertTrue(any("Twin" in said for texts in violations(files, counted=False).values()
                                for said in texts), where)

    def test_eigen_modules_that_are_used_are_included(self):
        where = "server/vision/geometry/a"

        def said(source, header=None):
            files = {where + ".cc": source}
            if header is not None:
                files[where + ".h"] = header
            return bool(violations(files))

        for use, module in (("p.homogeneous();", "Geometry"), ("a->cross(b);", "Geometry"),
                            ("Eigen::Quaterniond q;", "Geometry"), ("Eigen::JacobiSVD<M> d(m);", "SVD"),
                            ("m.ldlt().solve(b);", "Cholesky"), ("m.inverse();", "LU"),
                            ("m.colPivHouseholderQr();", "QR"), ("Eigen::SelfAdjointEigenSolver<M> s(m);", "Eigenvalues")):
            self.assertTrue(said("#include <Eigen/Core>\n" + use), use)
            self.assertFalse(said("#include <Eigen/%s>\n%s" % (module, use)), use)
            self.assertFalse(said(use, "#include <Eigen/%s>\n" % module), use)
            self.assertFalse(said("#include <Eigen/Dense>\n" + use), use)
            self.assertFalse(said("// %s\nconst char* s = \"%s\";\n" % (use, use)), use)
        # A header that somebody else includes says nothing: only the file's own does.
        self.assertTrue(violations({where + ".cc": '#include "server/vision/geometry/b.h"\nm.inverse();',
                                    "server/vision/geometry/b.h": "#include <Eigen/LU>\n"}))
        self.assertFalse(said("Inverse(m); inverse(m); determinant;"))

    def test_spacing_does_not_hide_an_include(self):
        self.assertTrue(violations({"db/x.cc": "  #  include\t<grpcpp/grpcpp.h>  // why\n"}))
        self.assertFalse(violations({"db/x.cc": '// #include <grpcpp/grpcpp.h>\nconst char* s = "#include <ceres/x.h>";\n'}))

    def test_the_client_is_no_part_of_the_server(self):
        for folder in layering.FOLDERS:
            if folder == "client" or folder.startswith("console"):  # a client of its own
                continue
            path = folder if folder.endswith(".cc") else folder + "/x.cc"
            self.assertTrue(one(path, '"client/cad_import.h"', ["client/cad_import.h"]), folder)


if __name__ == "__main__":
    unittest.main()
