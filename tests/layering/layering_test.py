#!/usr/bin/env python3
"""The layering check finds what it is there to find: planted violations in trees made for the purpose."""
import os
import sys
import tempfile
import unittest

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import layering  # noqa: E402


def violations(files):
    """Writes files ({path: text}) to a fresh tree and returns {path: [texts]} of what the check says."""
    with tempfile.TemporaryDirectory() as root:
        for path, text in files.items():
            full = os.path.join(root, path)
            os.makedirs(os.path.dirname(full), exist_ok=True)
            with open(full, "w", encoding="utf-8") as out:
                out.write(text)
        found, count = layering.check_tree(root)
        assert count == len([f for f in files if f.endswith(layering.SOURCES)])
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

    def test_geometry_knows_no_stage(self):
        for stage in layering.STAGES:
            header = stage_header(stage)
            self.assertTrue(one("server/vision/geometry/x.h", '"%s"' % header, [header]))

    def test_only_recognition_uses_the_index(self):
        for folder in layering.FOLDERS:
            if folder in ("server/index", "server/main.cc"):
                continue
            said = one(folder + "/x.cc", '"server/index/x_tree.h"', ["server/index/x_tree.h"])
            self.assertEqual(said == [], folder.startswith("server/vision/recognition"), folder)

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
        edge = {"server/service", "server/main.cc", "client", "proto"}
        for header in ("<grpcpp/grpcpp.h>", "<google/protobuf/message.h>", '"google/protobuf/util/time_util.h"'):
            for folder in layering.FOLDERS:
                path = folder if folder.endswith(".cc") else folder + "/x.cc"
                self.assertEqual(one(path, header) == [], folder in edge, "%s %s" % (folder, header))
        for folder in layering.FOLDERS:
            path = folder if folder.endswith(".cc") else folder + "/x.cc"
            self.assertEqual(one(path, "<sqlite3.h>") == [], folder == "db", folder)
            generated = one(path, '"horopter/v1/recognition.grpc.pb.h"')
            self.assertEqual(generated == [], folder in edge, folder)

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
        self.assertEqual(one("server/service/x.cc", "<opencv2/imgcodecs.hpp>"), [])
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

    def test_what_nobody_placed_is_a_violation(self):
        self.assertTrue(one("server/robots/x.cc", "<vector>"))
        self.assertTrue(one("server/x.h", "<vector>"))
        self.assertTrue(one("client/x.cc", "<boost/asio.hpp>"))
        self.assertTrue(one("client/x.cc", '"server/vision/geometry/gone.h"'))
        self.assertTrue(one("client/x.cc", '"bop_dataset.h"', ["client/bop_dataset.h"]))
        self.assertTrue(one("client/x.cc", "<server/base/stop_token.h>", ["server/base/stop_token.h"]))

    def test_spacing_does_not_hide_an_include(self):
        self.assertTrue(violations({"db/x.cc": "  #  include\t<grpcpp/grpcpp.h>  // why\n"}))
        self.assertFalse(violations({"db/x.cc": '// #include <grpcpp/grpcpp.h>\nconst char* s = "#include <ceres/x.h>";\n'}))

    def test_the_client_is_no_part_of_the_server(self):
        for folder in layering.FOLDERS:
            if folder == "client":
                continue
            path = folder if folder.endswith(".cc") else folder + "/x.cc"
            self.assertTrue(one(path, '"client/cad_import.h"', ["client/cad_import.h"]), folder)


if __name__ == "__main__":
    unittest.main()
