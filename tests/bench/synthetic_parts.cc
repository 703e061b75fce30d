// Makes a dataset of parts nobody has: prisms, brackets, flanges, plates, stepped and pocketed
// blocks of random sizes, as a catalog of many objects to measure with. STEP files, meshes and
// lists in BOP layout; `horopter dataset enroll FOLDER` enrols them.
//
//   synthetic_parts COUNT FOLDER [--seed N] [--first ID]
//     --first ID   number of the first object (default 1), to stand beside the parts of a dataset
#include <BRepAlgoAPI_Cut.hxx>
#include <BRepAlgoAPI_Fuse.hxx>
#include <BRepBuilderAPI_MakeFace.hxx>
#include <BRepBuilderAPI_MakePolygon.hxx>
#include <BRepPrimAPI_MakeBox.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <BRepPrimAPI_MakePrism.hxx>
#include <Interface_Static.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Message_PrinterOStream.hxx>
#include <STEPControl_Writer.hxx>
#include <Standard_Failure.hxx>
#include <TopoDS_Shape.hxx>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <gp_Ax2.hxx>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "client/bop_export.h"
#include "client/cad_import.h"

namespace horopter {
namespace {

// All lengths of this file are millimetres.
class Maker {
 public:
  explicit Maker(unsigned seed) : rng_(seed) {}

  struct Part {
    std::string name;
    TopoDS_Shape shape;
  };

  Part Make() {
    switch (rng_() % 7) {
      case 0:
        return {"prism", RegularPrism()};
      case 1:
        return {"profile", Profile()};
      case 2:
        return {"bracket", Bracket()};
      case 3:
        return {"flange", Flange()};
      case 4:
        return {"plate", Plate()};
      case 5:
        return {"stepped block", SteppedBlock()};
      default:
        return {"pocketed block", PocketedBlock()};
    }
  }

 private:
  // Rounded to half millimetres, as drawings are.
  double Size(double low, double high) {
    return std::round(2.0 * std::uniform_real_distribution<double>(low, high)(rng_)) / 2.0;
  }
  int Count(int low, int high) { return std::uniform_int_distribution<int>(low, high)(rng_); }

  static TopoDS_Shape Box(double x, double y, double z, double dx, double dy, double dz) {
    return BRepPrimAPI_MakeBox(gp_Pnt(x, y, z), dx, dy, dz).Shape();
  }
  static TopoDS_Shape Cylinder(const gp_Pnt& at,
                               const gp_Dir& along,
                               double radius,
                               double length) {
    return BRepPrimAPI_MakeCylinder(gp_Ax2(at, along), radius, length).Shape();
  }
  static TopoDS_Shape Cut(const TopoDS_Shape& from, const TopoDS_Shape& tool) {
    return BRepAlgoAPI_Cut(from, tool).Shape();
  }
  static TopoDS_Shape Fuse(const TopoDS_Shape& a, const TopoDS_Shape& b) {
    BRepAlgoAPI_Fuse fuse(a, b);
    fuse.SimplifyResult();
    return fuse.Shape();
  }
  static TopoDS_Shape Extrude(const std::vector<gp_Pnt>& polygon, double height) {
    BRepBuilderAPI_MakePolygon wire;
    for (const gp_Pnt& p : polygon) wire.Add(p);
    wire.Close();
    return BRepPrimAPI_MakePrism(BRepBuilderAPI_MakeFace(wire.Wire()).Face(), gp_Vec(0, 0, height))
        .Shape();
  }

  TopoDS_Shape RegularPrism() {
    const int corners = Count(3, 8);
    const double radius = Size(12, 45);
    std::vector<gp_Pnt> polygon;
    for (int i = 0; i < corners; ++i) {
      const double angle = 2.0 * M_PI * i / corners;
      polygon.emplace_back(radius * std::cos(angle), radius * std::sin(angle), 0);
    }
    const double height = Size(10, 90);
    const TopoDS_Shape prism = Extrude(polygon, height);
    if (Count(0, 1) == 0) return prism;
    return Cut(prism,
               Cylinder(gp_Pnt(0, 0, -1), gp::DZ(), radius * Size(0.5, 1.2) / 2.5, height + 2));
  }

  // L, T, U and Z profiles.
  TopoDS_Shape Profile() {
    const double w = Size(35, 90), h = Size(35, 90), t = Size(4, 14), length = Size(20, 100);
    const double s = Size(2, w / 2 - t);
    switch (Count(0, 3)) {
      case 0:
        return Extrude({{0, 0, 0}, {w, 0, 0}, {w, t, 0}, {t, t, 0}, {t, h, 0}, {0, h, 0}}, length);
      case 1:
        return Extrude({{0, 0, 0},
                        {w, 0, 0},
                        {w, t, 0},
                        {s + t, t, 0},
                        {s + t, h, 0},
                        {s, h, 0},
                        {s, t, 0},
                        {0, t, 0}},
                       length);
      case 2:
        return Extrude({{0, 0, 0},
                        {w, 0, 0},
                        {w, h, 0},
                        {w - t, h, 0},
                        {w - t, t, 0},
                        {t, t, 0},
                        {t, h - s / 2, 0},
                        {0, h - s / 2, 0}},
                       length);
      default:
        return Extrude({{0, 0, 0},
                        {w / 2 + t, 0, 0},
                        {w / 2 + t, h - t, 0},
                        {w, h - t, 0},
                        {w, h, 0},
                        {w / 2, h, 0},
                        {w / 2, t, 0},
                        {0, t, 0}},
                       length);
    }
  }

  TopoDS_Shape Bracket() {
    const double w = Size(35, 90), h = Size(35, 90), t = Size(4, 10), length = Size(25, 60);
    TopoDS_Shape part =
        Extrude({{0, 0, 0}, {w, 0, 0}, {w, t, 0}, {t, t, 0}, {t, h, 0}, {0, h, 0}}, length);
    if (Count(0, 1) == 1) {  // a rib
      const double rib = Size(3, 6), a = Size(10, w - t - 3), b = Size(10, h - t - 3);
      BRepBuilderAPI_MakePolygon wire(gp_Pnt(t, t, (length - rib) / 2),
                                      gp_Pnt(t + a, t, (length - rib) / 2),
                                      gp_Pnt(t, t + b, (length - rib) / 2),
                                      true);
      part =
          Fuse(part,
               BRepPrimAPI_MakePrism(BRepBuilderAPI_MakeFace(wire.Wire()).Face(), gp_Vec(0, 0, rib))
                   .Shape());
    }
    const double radius = Size(2, 5);
    const double at = Size(t + 2 * radius + 1, w - 2 * radius);
    part = Cut(part, Cylinder(gp_Pnt(at, -1, length / 5), gp::DY(), radius, t + 2));
    part = Cut(part, Cylinder(gp_Pnt(at, -1, length * 4 / 5), gp::DY(), radius, t + 2));
    return Cut(part,
               Cylinder(gp_Pnt(-1, h - 2.5 * radius, length / 2), gp::DX(), Size(3, 6), t + 2));
  }

  TopoDS_Shape Flange() {
    const double radius = Size(25, 55), t = Size(5, 14), hub = Size(8, radius / 2);
    const double hub_height = Size(8, 40);
    TopoDS_Shape part = Cylinder(gp::Origin(), gp::DZ(), radius, t);
    if (Count(0, 2) == 0) part = Box(-radius, -radius, 0, 2 * radius, 2 * radius, t);
    part = Fuse(part, Cylinder(gp_Pnt(0, 0, t), gp::DZ(), hub + 4, hub_height));
    part = Cut(part, Cylinder(gp_Pnt(0, 0, -1), gp::DZ(), hub, hub_height + t + 2));
    const int holes = Count(3, 8);
    for (int i = 0; i < holes; ++i) {
      const double angle = 2.0 * M_PI * i / holes, r = 0.78 * radius;
      part = Cut(
          part, Cylinder(gp_Pnt(r * std::cos(angle), r * std::sin(angle), -1), gp::DZ(), 3, t + 2));
    }
    return part;
  }

  TopoDS_Shape Plate() {
    const double w = Size(50, 120), h = Size(30, 90), t = Size(4, 14);
    TopoDS_Shape part = Box(0, 0, 0, w, h, t);
    const int columns = Count(1, 4), rows = Count(1, 3);
    const double radius = std::min({Size(2, 6), w / columns / 4, h / rows / 4});
    for (int i = 0; i < columns; ++i) {
      for (int k = 0; k < rows; ++k) {
        part = Cut(part,
                   Cylinder(gp_Pnt(w * (i + 0.5) / columns, h * (k + 0.5) / rows, -1),
                            gp::DZ(),
                            radius,
                            t + 2));
      }
    }
    const double notch = Size(6, h / 4);
    if (Count(0, 1) == 1)
      part = Cut(part, Box(-1, h - notch, -1, Size(6, w / 4) + 1, notch + 1, t + 2));
    if (Count(0, 1) == 1)
      part = Cut(part, Box(w / 3, -1, -1, Size(5, w / 4), Size(4, h / 5) + 1, t + 2));
    return part;
  }

  TopoDS_Shape SteppedBlock() {
    const double w = Size(40, 100), h = Size(30, 80);
    double z = Size(8, 25), x = w, y = h;
    TopoDS_Shape part = Box(0, 0, 0, w, h, z);
    const int steps = Count(1, 3);
    for (int i = 0; i < steps; ++i) {
      x *= Size(10, 17) / 20, y *= Size(12, 20) / 20;
      const double dz = Size(6, 20);
      part = Fuse(part, Box(Count(0, 1) * (w - x) / 2, (h - y) * Count(0, 2) / 2, z, x, y, dz));
      z += dz;
    }
    return part;
  }

  TopoDS_Shape PocketedBlock() {
    const double w = Size(40, 100), h = Size(35, 80), z = Size(15, 50), wall = Size(4, 10);
    TopoDS_Shape part = Box(0, 0, 0, w, h, z);
    const double floor = Size(4, z / 2), offset = Size(0, 6);
    part =
        Cut(part, Box(wall, wall + offset, floor, w - 2 * wall - offset, h - 2 * wall - offset, z));
    if (Count(0, 1) == 1) {
      part = Cut(part,
                 Cylinder(gp_Pnt(-1, h / 2, (floor + z) / 2), gp::DX(), (z - floor) / 4, wall + 2));
    }
    if (Count(0, 1) == 1)
      part = Cut(part, Box(w / 2 - 5, -1, z - 6, Size(8, 14), wall + offset + 2, 7));
    return part;
  }

  std::mt19937 rng_;
};

bool WriteStep(const TopoDS_Shape& shape, const std::string& path) {
  STEPControl_Writer writer;
  Interface_Static::SetCVal("write.step.unit", "MM");
  return writer.Transfer(shape, STEPControl_AsIs) == IFSelect_RetDone &&
         writer.Write(path.c_str()) == IFSelect_RetDone;
}

int Main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: synthetic_parts COUNT FOLDER [--seed N] [--first ID]\n");
    return 2;
  }
  unsigned seed = 1;
  int first = 1;
  for (int i = 3; i + 1 < argc; i += 2) {
    if (std::string(argv[i]) == "--seed") seed = static_cast<unsigned>(std::atoi(argv[i + 1]));
    if (std::string(argv[i]) == "--first") first = std::atoi(argv[i + 1]);
  }
  const std::string folder = argv[2];
  const int count = std::atoi(argv[1]);
  for (const char* name : {"models", "cad", "grasps"}) {
    std::filesystem::create_directories(folder + "/" + name);
  }
  Message::DefaultMessenger()->RemovePrinters(STANDARD_TYPE(Message_PrinterOStream));
  Maker maker(seed);
  std::vector<BopExportEntry> entries;
  int failed = 0;
  const std::string step = folder + "/part.step";
  while (static_cast<int>(entries.size()) < count && failed <= count) {
    ++failed;
    try {
      const Maker::Part part = maker.Make();
      if (!WriteStep(part.shape, step)) continue;
      const auto import = ImportCad(step, {});
      if (!import.ok()) continue;
      BopExportEntry entry;
      entry.obj_id = first + static_cast<int>(entries.size());
      entry.model = import->model;
      entry.model.display_name = part.name;
      entry.cad_format = "step";
      std::ifstream file(step, std::ios::binary);
      entry.cad_content = {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
      entry.low = entry.high = entry.model.mesh.vertices.at(0);
      for (const Eigen::Vector3d& v : entry.model.mesh.vertices) {
        entry.low = entry.low.cwiseMin(v);
        entry.high = entry.high.cwiseMax(v);
      }
      if (!WriteBopObject(folder, entry).ok()) return 1;
      entry.model.mesh = {};
      entry.model.edges.clear();
      entry.cad_content.clear();
      entries.push_back(std::move(entry));
      --failed;
    } catch (const Standard_Failure&) {  // a random size that leaves nothing; the next one
    }
  }
  std::filesystem::remove(step);
  if (!WriteBopLists(folder, entries).ok()) return 1;
  std::printf("%zu parts in %s, %d drawn again\n", entries.size(), folder.c_str(), failed);
  return static_cast<int>(entries.size()) == count ? 0 : 1;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  return horopter::Main(argc, argv);
}
