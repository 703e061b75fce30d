#include "tests/diagnose/overlay.h"

#include <cmath>
#include <opencv2/imgproc.hpp>

namespace horopter {
namespace {

constexpr int kScale = 2;

cv::Point2d At(const Eigen::Vector2d& p) {
  return {(p.x() + 0.5) * kScale - 0.5, (p.y() + 0.5) * kScale - 0.5};
}

cv::Mat Canvas(const cv::Mat& image) {
  cv::Mat bgr, out;
  if (image.channels() == 1) {
    cv::cvtColor(image, bgr, cv::COLOR_GRAY2BGR);
  } else {
    bgr = image;
  }
  cv::resize(bgr * 0.5, out, {}, kScale, kScale, cv::INTER_LINEAR);
  return out;
}

void Line(cv::Mat* canvas,
          const Eigen::Vector2d& a,
          const Eigen::Vector2d& b,
          const cv::Scalar& colour,
          int width = 1) {
  cv::line(*canvas, At(a), At(b), colour, width, cv::LINE_AA);
}

void DrawArcs(const ImageFeatures& features, cv::Mat* canvas) {
  for (const EllipseArc& arc : features.arcs) {
    const double degrees = 180.0 / CV_PI;
    cv::ellipse(*canvas,
                At(arc.center),
                cv::Size2d(arc.semi_major_px * kScale, arc.semi_minor_px * kScale),
                arc.angle_rad * degrees,
                arc.start_rad * degrees,
                (arc.start_rad + arc.sweep_rad) * degrees,
                cv::Scalar(255, 255, 255),
                1,
                cv::LINE_AA);
  }
}

}  // namespace

cv::Mat DrawFeatures(const cv::Mat& image, const ImageFeatures& features) {
  cv::Mat canvas = Canvas(image);
  for (const Segment& segment : features.segments) {
    Line(&canvas,
         segment.start,
         segment.end,
         segment.in_texture ? cv::Scalar(70, 90, 140) : cv::Scalar(0, 255, 255));
  }
  DrawArcs(features, &canvas);
  for (const Junction& junction : features.junctions) {
    bool tee = false;
    for (const Junction::End& end : junction.ends) {
      tee |= end.interior;
    }
    cv::circle(canvas,
               At(junction.point),
               tee ? 2 : 4,
               tee ? cv::Scalar(255, 128, 0) : cv::Scalar(0, 0, 255),
               1,
               cv::LINE_AA);
  }
  return canvas;
}

cv::Mat DrawFeatureGraph(const cv::Mat& image,
                         const ImageFeatures& features,
                         const FeatureGraph& graph) {
  cv::Mat canvas = Canvas(image);
  const auto middle = [&](uint32_t node) -> Eigen::Vector2d {
    const Segment& s = features.segments[graph.IndexOf(node)];
    return 0.5 * (s.start + s.end);
  };
  for (uint32_t node = 0; node < static_cast<uint32_t>(graph.NodeCount()); ++node) {
    for (const GraphEdge& edge : graph.EdgesOf(node)) {
      if (edge.node < node) continue;
      if (edge.relation == FeatureRelation::kParallel) {
        Line(&canvas, middle(node), middle(edge.node), cv::Scalar(0, 140, 0));
      } else if (edge.relation == FeatureRelation::kCollinear) {
        Line(&canvas, middle(node), middle(edge.node), cv::Scalar(0, 200, 200));
      }
    }
  }
  for (const Segment& segment : features.segments) {
    if (segment.in_texture) continue;
    const Eigen::Vector2d d = segment.end - segment.start;
    const double direction = std::atan2(d.y(), d.x());
    // Opposite directions are different edges: the brighter side is on the right.
    const auto level = [&](double phase) { return 140.0 + 115.0 * std::cos(direction + phase); };
    Line(&canvas,
         segment.start,
         segment.end,
         cv::Scalar(level(0.0), level(2.1), level(4.2)),
         segment.arc >= 0 ? 1 : 2);
  }
  DrawArcs(features, &canvas);
  for (const Junction& junction : features.junctions) {
    cv::Scalar colour(255, 0, 255);
    if (junction.type == JunctionType::kL) colour = cv::Scalar(0, 0, 255);
    if (junction.type == JunctionType::kT) colour = cv::Scalar(255, 128, 0);
    if (junction.type == JunctionType::kArrow || junction.type == JunctionType::kY) {
      colour = cv::Scalar(0, 165, 255);
    }
    cv::circle(canvas, At(junction.point), 4, colour, cv::FILLED, cv::LINE_AA);
  }
  for (const ConicJunction& junction : features.conic_junctions) {
    cv::circle(canvas, At(junction.point), 3, cv::Scalar(255, 255, 0), cv::FILLED, cv::LINE_AA);
  }
  return canvas;
}

cv::Mat DrawTracks(const std::array<cv::Mat, 2>& images,
                   const std::array<ImageFeatures, 2>& features,
                   const std::array<int, 2>& views,
                   const MatchingResult& matching) {
  cv::Mat canvas[2] = {Canvas(images[0]), Canvas(images[1])};
  const auto draw = [&](const std::vector<FeatureTrack>& tracks, const auto& draw_feature) {
    for (size_t k = 0; k < tracks.size(); ++k) {
      int feature[2] = {-1, -1};
      for (const FeatureTrack::Feature& f : tracks[k].features) {
        for (int v = 0; v < 2; ++v) {
          if (f.view == views[v]) feature[v] = f.feature;
        }
      }
      if (feature[0] < 0 || feature[1] < 0) continue;
      // Hues far apart for neighbours in the list.
      const double hue = std::fmod(0.381966 * static_cast<double>(k), 1.0);
      const auto wave = [&](double shift) {
        return 155.0 + 100.0 * std::cos(2.0 * CV_PI * (hue + shift));
      };
      const cv::Scalar colour(wave(0.0), wave(1.0 / 3.0), wave(2.0 / 3.0));
      for (int v = 0; v < 2; ++v)
        draw_feature(v, feature[v], colour, tracks[k].features.size() >= 3 ? 3 : 1);
    }
  };
  draw(matching.segment_tracks, [&](int v, int i, const cv::Scalar& colour, int width) {
    const Segment& s = features[v].segments[i];
    Line(&canvas[v], s.start, s.end, colour, width);
  });
  draw(matching.junction_tracks, [&](int v, int i, const cv::Scalar& colour, int width) {
    cv::circle(canvas[v], At(features[v].junctions[i].point), 7, colour, width, cv::LINE_AA);
  });
  cv::Mat both;
  if (canvas[0].rows != canvas[1].rows)
    cv::resize(canvas[1], canvas[1], cv::Size(canvas[1].cols, canvas[0].rows));
  cv::hconcat(canvas[0], canvas[1], both);
  return both;
}

cv::Mat DrawTruth(const cv::Mat& image,
                  const ImageFeatures& features,
                  const TrueView& truth,
                  const FeatureFinding& finding,
                  const std::vector<DrawnObject>& answer) {
  cv::Mat canvas = Canvas(image);
  for (const Segment& segment : features.segments) {
    Line(&canvas,
         segment.start,
         segment.end,
         segment.in_texture ? cv::Scalar(70, 70, 70) : cv::Scalar(150, 150, 60));
  }
  for (size_t e = 0; e < truth.edges.size(); ++e) {
    const bool found = finding.edges[e].covered >= kFoundEdgeShare;
    const TrueEdge& edge = truth.edges[e];
    for (size_t k = 0; k < edge.points.size(); ++k) {
      cv::circle(canvas,
                 At(edge.points[k]),
                 found ? 0 : 1,
                 found ? cv::Scalar(0, 255, 0) : cv::Scalar(0, 0, 255),
                 -1);
    }
  }
  for (size_t c = 0; c < truth.corners.size(); ++c) {
    const bool found = finding.corner_error_px[c] < kCornerPx;
    cv::circle(canvas,
               At(truth.corners[c].point),
               6,
               found ? cv::Scalar(0, 255, 0) : cv::Scalar(0, 0, 255),
               1,
               cv::LINE_AA);
  }
  for (const DrawnObject& wireframe : answer) {
    for (const ModelEdge& edge : wireframe.model->edges) {
      for (size_t k = 0; k + 1 < edge.polyline.size(); ++k) {
        const Eigen::Vector3d a = wireframe.camera_from_object * edge.polyline[k];
        const Eigen::Vector3d b = wireframe.camera_from_object * edge.polyline[k + 1];
        if (a.z() > 1e-3 && b.z() > 1e-3) {
          Line(&canvas,
               Project(wireframe.camera, a),
               Project(wireframe.camera, b),
               cv::Scalar(255, 0, 255));
        }
      }
    }
  }
  return canvas;
}

}  // namespace horopter
