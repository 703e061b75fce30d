"""Names that files compiled as one may not share, planted in trees of two files."""
import os
import sys
import tempfile
import unittest

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import single_names  # noqa: E402


def own(text):
    return "namespace horopter {\nnamespace {\n%s\n}  // namespace\n}  // namespace horopter\n" % text


def named(text, path="a.cc"):
    return sorted(single_names.own_names(path, text))


def violations(files):
    with tempfile.TemporaryDirectory() as root:
        for path, text in files.items():
            os.makedirs(os.path.dirname(os.path.join(root, path)), exist_ok=True)
            with open(os.path.join(root, path), "w", encoding="utf-8") as file:
                file.write(text)
        return single_names.check_names(root)


class Names(unittest.TestCase):

    def test_what_a_file_has_of_its_own(self):
        for text, names in (
                ("constexpr double kA = 1.0, kB = 2.0;  // kC = 3", ["kA", "kB"]),
                ("constexpr int kA[] = {1, 2};", ["kA"]),
                ("constexpr std::array<int, kN> kA{{1, 2}};", ["kA"]),
                ("constexpr Pair kA = {kX, kY};", ["kA"]),
                ("constexpr int kA = 1, kB = kX;", ["kA", "kB"]),
                ("constexpr int kA{1};", ["kA"]),
                ("const std::map<int, std::string> kA = {{1, \"kB = 1;\"}};", ["kA"]),
                ("struct Point {\n  double kX = 0.0;\n  void F() {}\n};", ["Point"]),
                ("enum class Mode : int { kA, kB };", ["Mode"]),
                ("class A final : public B<int> {\n public:\n  A() {}\n};", ["A"]),
                ("int F(int a, double b = G(1)) {\n  const int kInner = a;\n  return kInner;\n}", ["F"]),
                ("std::vector<std::pair<int, int>> F() { return {}; }", ["F"]),
                ("template <typename T>\nT F(T x) {\n  return x;\n}", ["F"]),
                ("template <int N>\nstruct S {};", ["S"]),
                ("using Points = std::vector<Point>;", ["Points"]),
                ("using Eigen::Vector3d;", ["Vector3d"]),
                ("int F(int a, const Options& b = {}) {\n  return a;\n}\nint G() {\n  return 1;\n}", ["F", "G"]),
                ("int F(int a);", []),
                ("static_assert(kA == 1);", []),
                ("std::atomic<int> count{0};", ["count"]),
                ("int F() {\n  return 1;\n}\nint G() {\n  return 2;\n}", ["F", "G"])):
            self.assertEqual(named(own(text)), names, text)

    def test_outside_of_anonymous_namespaces_only_what_is_not_linked(self):
        text = ("namespace horopter {\nint F() {\n  return 1;\n}\nconstexpr int kA = 1;\nstatic int G() { return 2; }\n"
                "const Table& T() {\n  static const Table kInner;\n  return kInner;\n}\nstruct S {};\n}\n")
        self.assertEqual(named(text), ["G", "kA"])
        self.assertEqual(named("namespace horopter {\ninline constexpr int kA = 1;\nstruct S {};\nstruct T;\nusing U = int;\nint F();\n}\n", "a.h"),
                         ["S", "U", "kA"])


class Tree(unittest.TestCase):

    def test_two_files_of_a_folder(self):
        for first, second in (("constexpr int kA = 1;", "constexpr int kA = 1;"),
                              ("constexpr int kA = 1;", "constexpr double kB = 1, kA = 2;"),
                              ("int F(int x) {\n  return x;\n}", "int F(double x) {\n  return 1;\n}"),
                              ("struct S {};", "class S {};"),
                              ("using A = int;", "using A = double;"),
                              ("using A = int;", "struct A {};")):
            found = violations({"db/a.cc": own(first), "db/b.cc": own(second)})
            self.assertEqual([path for path, _, _ in found], ["db/b.cc"], first)
            self.assertFalse(violations({"db/a.cc": own(first), "server/index/b.cc": own(second)}), first)
        for text in ("using A = int;", "using Eigen::Vector3d;", "namespace fs = std::filesystem;"):
            self.assertFalse(violations({"db/a.cc": own(text), "db/b.cc": own(text)}), text)

    def test_a_constant_of_a_header_counts(self):
        header = "namespace horopter {\ninline constexpr int kA = 1;\n}\n"
        self.assertTrue(violations({"db/a.h": header, "db/b.cc": own("constexpr int kA = 1;")}))

    def test_a_constant_of_a_header_that_another_file_of_the_folder_includes_counts(self):
        tree = {"server/base/a.h": "namespace horopter {\ninline constexpr int kA = 1;\n}\n",
                "server/base/b.h": '#include "server/base/a.h"\n',
                "db/c.cc": '#include "server/base/b.h"\n', "db/d.cc": own("constexpr int kA = 1;")}
        self.assertEqual([path for path, _, _ in violations(tree)], ["db/d.cc"])
        self.assertFalse(violations({**tree, "db/c.cc": ""}))
        self.assertFalse(violations({**tree, "db/d.cc": own("constexpr int kB = kA;")}))

    def test_a_constant_of_a_function_hides_none_of_the_folder(self):
        inside = own("int F() {\n  constexpr int kA = 1;\n  return kA;\n}")
        self.assertTrue(violations({"db/a.cc": own("constexpr int kA = 1;"), "db/b.cc": inside}))
        self.assertFalse(violations({"db/a.cc": own("constexpr int kB = 1;"), "db/b.cc": inside}))
        self.assertFalse(violations({"db/a.cc": inside.replace("F", "G"), "db/b.cc": inside}))

    def test_the_client_is_one_folder(self):
        text = own("constexpr int kA = 1;")
        self.assertTrue(violations({"client/a.cc": text, "client/load/b.cc": text}))


class Batches(unittest.TestCase):

    def batches(self, size, texts):
        with tempfile.TemporaryDirectory() as root:
            paths = []
            for number, text in enumerate(texts):
                paths.append(os.path.join(root, "%d.cc" % number))
                with open(paths[-1], "w", encoding="utf-8") as file:
                    file.write(own(text))
            return [[int(os.path.basename(path)[:-3]) for path in batch] for batch in single_names.batches(size, paths)]

    def test_no_name_twice_in_a_batch(self):
        a, b, ab = "constexpr int kA = 1;", "int F() {\n  return 1;\n}", "struct kA {};\nstruct F {};"
        self.assertEqual(self.batches(16, [a, b, ab, a, b]), [[0, 1], [2], [3, 4]])
        self.assertEqual(self.batches(16, ["using A = int;", "using A = int;", "using A = long;"]), [[0, 1], [2]])

    def test_tests_are_no_names(self):
        test = "TEST(Suite, Name%d) {\n  EXPECT_TRUE(true);\n}\nINSTANTIATE_TEST_SUITE_P(All, Suite, Values(1));"
        self.assertEqual(self.batches(16, [test % 1, test % 2]), [[0, 1]])

    def test_a_batch_has_no_more_files_than_asked_for(self):
        self.assertEqual(self.batches(2, ["constexpr int kA%d = 1;" % i for i in range(5)]), [[0, 1], [2, 3], [4]])


if __name__ == "__main__":
    unittest.main()
