// Parts that look like those of a data set but for one round hole: moved by its diameter, or
// filled. What a decision must not take for the real ones.
//
//   decoy_parts DATASET OUT moved|filled
//
// Reads DATASET/cad/obj_*.step, writes OUT/cad of the same names for those with a hole that can be
// changed, and prints a line for each part: radius and place of the hole, mm, or why there is none.
#include <BRepAdaptor_Surface.hxx>
#include <BRepAlgoAPI_Cut.hxx>
#include <BRepAlgoAPI_Defeaturing.hxx>
#include <BRepBndLib.hxx>
#include <BRepGProp.hxx>
#include <BRepPrimAPI_MakeCylinder.hxx>
#include <Bnd_Box.hxx>
#include <GProp_GProps.hxx>
#include <Message.hxx>
#include <Message_Messenger.hxx>
#include <Message_PrinterOStream.hxx>
#include <STEPControl_Reader.hxx>
#include <STEPControl_Writer.hxx>
#include <TopExp_Explorer.hxx>
#include <TopoDS.hxx>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <gp_Ax2.hxx>
#include <gp_Cylinder.hxx>
#include <iostream>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

namespace horopter {
namespace {

// Shares of the diagonal of the part: of holes that an image shows.
constexpr double kLeastRadius = 0.012, kMostRadius = 0.15;

struct Hole {
  gp_Ax1 axis;
  double radius = 0.0;
  double low = 0.0, high = 0.0;  // of the wall along the axis, from its location
};

Bnd_Box BoxOf(const TopoDS_Shape& shape) {
  Bnd_Box box;
  BRepBndLib::Add(shape, box);
  return box;
}

double VolumeOf(const TopoDS_Shape& shape) {
  GProp_GProps properties;
  BRepGProp::VolumeProperties(shape, properties);
  return properties.Mass();
}

// Whole round walls with the material outside, widest first.
std::vector<Hole> HolesOf(const TopoDS_Shape& part, double diagonal) {
  std::vector<Hole> out;
  for (TopExp_Explorer e(part, TopAbs_FACE); e.More(); e.Next()) {
    const TopoDS_Face& face = TopoDS::Face(e.Current());
    const BRepAdaptor_Surface surface(face);
    if (surface.GetType() != GeomAbs_Cylinder) continue;
    const gp_Cylinder cylinder = surface.Cylinder();
    const bool whole =
        surface.LastUParameter() - surface.FirstUParameter() > 1.98 * std::numbers::pi;
    const bool inside = (face.Orientation() == TopAbs_REVERSED) == cylinder.Direct();
    if (!whole || !inside || cylinder.Radius() < kLeastRadius * diagonal ||
        cylinder.Radius() > kMostRadius * diagonal)
      continue;
    out.push_back(
        {cylinder.Axis(), cylinder.Radius(), surface.FirstVParameter(), surface.LastVParameter()});
  }
  std::stable_sort(
      out.begin(), out.end(), [](const Hole& a, const Hole& b) { return a.radius > b.radius; });
  return out;
}

// Without the faces that lie within the hole: walls, chamfers, its bottom.
std::optional<TopoDS_Shape> Filled(const TopoDS_Shape& part, const Hole& hole) {
  BRepAlgoAPI_Defeaturing removal;
  removal.SetShape(part);
  const gp_Lin line(hole.axis);
  for (TopExp_Explorer e(part, TopAbs_FACE); e.More(); e.Next()) {
    double farthest = 0.0;
    for (TopExp_Explorer v(e.Current(), TopAbs_EDGE); v.More(); v.Next()) {
      const Bnd_Box box = BoxOf(v.Current());
      const gp_Pnt middle((box.CornerMin().XYZ() + box.CornerMax().XYZ()) / 2.0);
      const double reach = box.CornerMin().Distance(box.CornerMax()) / 2.0;
      farthest = std::max(farthest, std::max(line.Distance(middle), reach / std::sqrt(2.0)));
    }
    if (farthest < 1.9 * hole.radius) removal.AddFaceToRemove(e.Current());
  }
  removal.Build();
  if (removal.HasErrors() || removal.Shape().IsNull() ||
      VolumeOf(removal.Shape()) <= VolumeOf(part) * (1.0 + 1e-6))
    return std::nullopt;
  return removal.Shape();
}

// The hole once more, a diameter beside where it was and wholly in the part.
std::optional<TopoDS_Shape> Moved(const TopoDS_Shape& part, const Hole& hole) {
  const auto filled = Filled(part, hole);
  if (!filled) return std::nullopt;
  const double volume = VolumeOf(*filled), taken = volume - VolumeOf(part);
  const gp_Ax2 frame(hole.axis.Location(), hole.axis.Direction());
  const double margin = 0.5 * hole.radius;
  for (int k = 0; k < 12; ++k) {
    const double angle = k * std::numbers::pi / 6.0;
    const gp_Vec beside =
        gp_Vec(frame.XDirection()) * std::cos(angle) + gp_Vec(frame.YDirection()) * std::sin(angle);
    gp_Ax2 at = frame;
    at.SetLocation(frame.Location()
                       .Translated(beside * (2.0 * hole.radius))
                       .Translated(gp_Vec(frame.Direction()) * (hole.low - margin)));
    const TopoDS_Shape drill =
        BRepPrimAPI_MakeCylinder(at, hole.radius, hole.high - hole.low + 2.0 * margin).Shape();
    BRepAlgoAPI_Cut cut(*filled, drill);
    if (cut.HasErrors() || cut.Shape().IsNull()) continue;
    const double now = volume - VolumeOf(cut.Shape());
    if (now > 0.8 * taken && now < 1.3 * taken) return cut.Shape();
  }
  return std::nullopt;
}

bool Write(const TopoDS_Shape& shape, const std::filesystem::path& path) {
  STEPControl_Writer writer;
  return writer.Transfer(shape, STEPControl_AsIs) == IFSelect_RetDone &&
         writer.Write(path.c_str()) == IFSelect_RetDone;
}

std::string MakeDecoy(const std::filesystem::path& cad,
                      const std::filesystem::path& out,
                      bool move) {
  STEPControl_Reader reader;
  if (reader.ReadFile(cad.c_str()) != IFSelect_RetDone || reader.TransferRoots() < 1)
    return "not read";
  const TopoDS_Shape part = reader.OneShape();
  const Bnd_Box box = BoxOf(part);
  for (const Hole& hole : HolesOf(part, box.CornerMin().Distance(box.CornerMax()))) {
    const auto decoy = move ? Moved(part, hole) : Filled(part, hole);
    if (!decoy || !Write(*decoy, out)) continue;
    const gp_Pnt p = hole.axis.Location();
    return "radius " + std::to_string(hole.radius) + " at " + std::to_string(p.X()) + " " +
           std::to_string(p.Y()) + " " + std::to_string(p.Z());
  }
  return "no hole that can be changed";
}

int Run(const std::string& dataset, const std::string& out, const std::string& kind) {
  Message::DefaultMessenger()->RemovePrinters(STANDARD_TYPE(Message_PrinterOStream));
  const std::filesystem::path to = std::filesystem::path(out) / "cad";
  std::filesystem::create_directories(to);
  std::vector<std::filesystem::path> parts;
  for (const auto& entry : std::filesystem::directory_iterator(dataset + "/cad")) {
    if (entry.path().extension() == ".step") parts.push_back(entry.path());
  }
  std::sort(parts.begin(), parts.end());
  for (const std::filesystem::path& part : parts) {
    std::string said;
    try {
      said = MakeDecoy(part, to / part.filename(), kind == "moved");
    } catch (const Standard_Failure& failure) {
      said = failure.GetMessageString();
    }
    std::cout << part.stem().string() << " " << said << std::endl;
  }
  return 0;
}

}  // namespace
}  // namespace horopter

int main(int argc, char** argv) {
  const std::string kind = argc == 4 ? argv[3] : "";
  if (kind != "moved" && kind != "filled")
    return std::cerr << "usage: decoy_parts DATASET OUT moved|filled\n", 2;
  return horopter::Run(argv[1], argv[2], kind);
}
