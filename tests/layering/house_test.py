"""The counts of house.py on sources small enough to count by hand."""
import contextlib
import io
import os
import sys
import tempfile
import unittest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import house  # noqa: E402


class Functions(unittest.TestCase):
    def lines(self, text):
        return [(lines, name) for lines, name in house.functions(text)]

    def test_bodies_count_from_the_first_word_to_the_brace(self):
        self.assertEqual(self.lines("namespace a {\nint F(int x,\n      int y) {\n  return x;\n}\n}\n"),
                         [(4, "int F(int x, int y)")])

    def test_a_condition_of_the_preprocessor_over_several_lines_is_no_function(self):
        text = "#if defined(A) && \\\n    !defined(B)\nnamespace a {\nint F() {\n}\n}\n#endif\n"
        with tempfile.TemporaryDirectory() as root:
            path = os.path.join(root, "a.cc")
            with open(path, "w", encoding="utf-8") as file:
                file.write(text)
            self.assertEqual(self.lines(house.code_of(path)), [(2, "int F()")])

    def test_members_count_and_what_stands_inside_does_not(self):
        text = "class A {\n void F() {\n  auto f = [](int x) {\n   if (x) {\n   }\n  };\n }\n};\nint g[] = {1};\n"
        self.assertEqual(self.lines(text), [(6, "void F()")])


class Tree(unittest.TestCase):
    def test_rooms_arrows_and_options(self):
        files = {
            "server/vision/recognition/low/a.h": "struct AOptions {\n  int x = 0;  // not } this\n  BOptions b;\n};\n",
            "server/vision/recognition/low/b.h": "struct BOptions {\n  double y = 1.0;\n};\nstruct LostOptions {\n  int z = 0;\n};\n",
            "server/vision/recognition/high/c.cc": '#include "server/vision/recognition/low/a.h"\n'
                                                   "struct PipelineOptions {\n  AOptions a;\n};\n",
            "server/service/server.h": "struct ServerOptions {\n  int port = 0;\n};\n", "client/d.cc": "", "db/e.cc": ""}
        with tempfile.TemporaryDirectory() as root:
            for path, text in files.items():
                os.makedirs(os.path.dirname(os.path.join(root, path)), exist_ok=True)
                with open(os.path.join(root, path), "w", encoding="utf-8") as file:
                    file.write(text)
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                house.print_rooms(root)
                house.print_options(root)
        self.assertIn("low: 2 modules, 10 lines", out.getvalue())
        self.assertIn("arrows between rooms: 1, includes: 1\n  high -> low", out.getvalue())
        self.assertIn("options: 5 structs, 4 fields\n  in server/vision/recognition: 4 structs, 3 fields\n  reached from PipelineOptions: 3 structs, 2 fields\n"
                      "  reached from ServerOptions: 1 structs, 1 fields\n"
                      "  by none of these: 1 structs, 1 fields: LostOptions\n", out.getvalue())


class Constants(unittest.TestCase):
    def test_a_comment_beside_or_above_explains_and_one_above_a_run_explains_all_of_it(self):
        text = ("// of both\nconstexpr int kA = 1;\nconstexpr int kB = 2;\n\nconstexpr int kC = 3;\n"
                "constexpr int kD = 4;  // metres\nconstexpr int kE = 5;\n"
                "constexpr double kPi = std::numbers::pi;\n")
        with tempfile.TemporaryDirectory() as root:
            path = os.path.join(root, "a.cc")
            with open(path, "w", encoding="utf-8") as file:
                file.write(text)
            self.assertEqual(house.bare_constants(path), (5, [5, 7]))


if __name__ == "__main__":
    unittest.main()
