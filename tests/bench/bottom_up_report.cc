#include <cstdio>
#include <Eigen/Dense>
#include <chrono>
#include <set>
#include "server/vision/recognition/projective_route.h"
#include "server/vision/reconstruction/grow_projective.h"
#include "tests/support/profile_parts.h"
using namespace horopter;
int main(int argc, char** argv) {
  const int scenes = argc > 1 ? atoi(argv[1]) : 6, count = argc > 2 ? atoi(argv[2]) : 100;
  const int draws = argc > 3 ? atoi(argv[3]) : 2000, keys_kept = argc > 4 ? atoi(argv[4]) : 200;
  std::vector<ObjectModel> catalog; std::vector<ObjectKeys> keys;
  std::vector<const ObjectKeys*> key_ptrs;
  double verts=0, nk=0; int none=0;
  ObjectKeyOptions ko; ko.six_point_draws = draws; ko.max_six_points = keys_kept; ko.max_path_views=0;
  for (int i = 0; i < count; ++i) { catalog.push_back(ProfilePart(i + 1)); keys.push_back(ComputeObjectKeys(catalog.back(), ko)); verts += catalog.back().vertices.size(); nk += keys.back().six_points.size(); none += keys.back().six_points.empty(); }
  for (auto& k : keys) key_ptrs.push_back(&k);
  std::printf("mean vertices %.1f, keys %.1f, without %d\n", verts / count, nk / count, none);
  auto index = KeyIndex::Build(key_ptrs, 1, 2);
  if (!index.ok()) { std::puts(std::string(index.status().message()).c_str()); return 1; }
  KeyIndexSnapshot snap = index->Snapshot();
  std::vector<StructureObject> objects;
  for (int i = 0; i < count; ++i) objects.push_back({&catalog[i], &keys[i], i});
  int right = 0, found = 0, all = 0, best_wrong=0, all_keyed=0; double time = 0;
  for (int s = 1; s <= scenes; ++s) {
    ProfileSceneOptions so; so.seed = s;
    ProfileScene scene = MakeProfileScene(catalog, so);
    auto rec = ReconstructProjective(scene.tracks.tracks, {});
    if (!rec.ok() || rec->outcome != ProjectiveOutcome::kReconstructed) { std::printf("scene %d: %s\n", s, rec.ok() ? rec->reason.c_str() : ""); continue; }
    auto st = ProjectiveStructure(scene.tracks.tracks, rec->scene, scene.edges);
    if (!st.ok()) { std::printf("scene %d: %s\n", s, std::string(st.status().message()).c_str()); continue; }
    auto t0 = std::chrono::steady_clock::now();
    auto r = ProjectiveHypotheses(*st, snap, objects, {});
    time += std::chrono::duration<double>(std::chrono::steady_clock::now() - t0).count();
    if (!r.ok()) { std::printf("scene %d: %s\n", s, std::string(r.status().message()).c_str()); continue; }
    std::printf("scene %d: factor %.2f pts %zu lines %zu comps %zu", s, st->sigma_factor, st->points.size(), st->lines.size(), r->components.size());
    for (auto& [k, v] : r->counts) std::printf(" %s %.0f", k.c_str(), v);
    std::puts("");
    // best per true part
    for (int p = 0; p < 3; ++p) {
      const StructureHypothesis *best = nullptr, *true_best = nullptr; 
      for (auto& h : r->hypotheses) {
        int of_part = 0; int correct = 0;
        for (auto& m : h.vertices) { int tr = st->point_track[m.point]; of_part += scene.part_of_point[tr] == p; correct += scene.part_of_point[tr]==p && scene.vertex_of_point[tr]==m.vertex; }
        if (2 * of_part < (int)h.vertices.size()) continue;
        if (!best) best = &h;
        if (h.object == scene.objects[p] && 10*correct > 7*(int)h.vertices.size() && !true_best) true_best = &h;
      }
      { std::vector<VertexMatch> m; for (size_t i=0;i<st->points.size();++i) { int tr=st->point_track[i]; if (scene.part_of_point[tr]==p && scene.vertex_of_point[tr]>=0) m.push_back({scene.vertex_of_point[tr],(int)i}); }
        ObjectShape sh = ShapeOf(catalog[scene.objects[p]]); auto H = FitTransform(TransformGroup::kCollineation, *st, sh, m, {}); if (H.ok()) { auto ev = GatherEvidence(*st); Eigen::Matrix4d X = *H; auto j = JudgeTransform(TransformGroup::kCollineation, ev, sh, X); std::printf("   det %g truth log odds %.1f %zu v %zu e rms %.2f\n", X.determinant(), j.log_odds, j.vertices.size(), j.edges.size(), j.rms_sigma);} }
      int npts=0; for (size_t i=0;i<st->points.size();++i) npts += scene.part_of_point[st->point_track[i]]==p && scene.vertex_of_point[st->point_track[i]]>=0;
      ++all; right += best && best == true_best; found += true_best != nullptr;
      all_keyed += !keys[scene.objects[p]].six_points.empty();
      best_wrong += best && best != true_best;
      std::printf("  part %d obj %d V %zu seen %d keys %zu: best %d (%.1f, %zu v %zu e, votes %d)  true %.1f %zu v %zu e votes %d rms %.2f\n", p, scene.objects[p], catalog[scene.objects[p]].vertices.size(), npts, keys[scene.objects[p]].six_points.size(), best ? best->object : -1, best ? best->log_odds : 0, best ? best->vertices.size() : 0, best ? best->edges.size() : 0, best?best->votes:0, true_best ? true_best->log_odds : 0, true_best ? true_best->vertices.size() : 0, true_best?true_best->edges.size():0, true_best?true_best->votes:0, true_best?true_best->rms_sigma:0);
    }
  }
  std::printf("right best %d, found %d, of %d (%d with keys), wrong best %d; %.3f s a scene\n", right, found, all, all_keyed, best_wrong, time / scenes);
}
