#include "server/vision/geometry/depth_buffer.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace horopter {
namespace {

constexpr double kNearM = 1e-3;  // nothing is drawn nearer to the camera

struct ScreenPoint {
  double u = 0.0;
  double v = 0.0;
  double inverse_z = 0.0;  // linear over the screen, unlike z
};

ScreenPoint ToScreen(const PinholeCamera& camera, const Eigen::Vector3d& p) {
  const double w = 1.0 / p.z();
  return {camera.focal_px * p.x() * w + camera.cx, camera.focal_px * p.y() * w + camera.cy, w};
}

// One scan line: pixels first..last with inverse depth start + step * x.
void FillSpan(float* row, int first, int last, float start, float step) {
  for (int x = first; x <= last; ++x) {
    const float z = 1.0f / (start + step * static_cast<float>(x));
    row[x] = std::min(row[x], z);
  }
}

void FillTriangle(const ScreenPoint& a,
                  const ScreenPoint& b,
                  const ScreenPoint& c,
                  DepthBuffer* buffer) {
  const double lowest = std::min({a.v, b.v, c.v});
  const double highest = std::max({a.v, b.v, c.v});
  // Most triangles of a fine mesh lie between the pixels' centres.
  if (std::ceil(lowest) > highest ||
      std::ceil(std::min({a.u, b.u, c.u})) > std::max({a.u, b.u, c.u})) {
    return;
  }
  const double area = (b.u - a.u) * (c.v - a.v) - (c.u - a.u) * (b.v - a.v);
  if (std::abs(area) < 1e-12) {
    return;
  }
  // inverse_z = a.inverse_z + gu (u - a.u) + gv (v - a.v)
  const double gu =
      ((b.inverse_z - a.inverse_z) * (c.v - a.v) - (c.inverse_z - a.inverse_z) * (b.v - a.v)) /
      area;
  const double gv =
      ((c.inverse_z - a.inverse_z) * (b.u - a.u) - (b.inverse_z - a.inverse_z) * (c.u - a.u)) /
      area;
  if (highest < 0.0 || lowest > buffer->height - 1) {
    return;
  }
  const int first_row = static_cast<int>(std::ceil(std::max(lowest, 0.0)));
  const int last_row = static_cast<int>(std::floor(std::min(highest, buffer->height - 1.0)));
  const double far_inverse = std::min({a.inverse_z, b.inverse_z, c.inverse_z});
  const std::array<const ScreenPoint*, 4> loop = {&a, &b, &c, &a};
  for (int y = first_row; y <= last_row; ++y) {
    double left = 1e18;
    double right = -1e18;
    for (int k = 0; k < 3; ++k) {
      const ScreenPoint& p = *loop[k];
      const ScreenPoint& q = *loop[k + 1];
      if ((p.v < y && q.v < y) || (p.v > y && q.v > y)) {
        continue;
      }
      if (p.v == q.v) {
        left = std::min({left, p.u, q.u});
        right = std::max({right, p.u, q.u});
        continue;
      }
      const double u = p.u + (q.u - p.u) * (y - p.v) / (q.v - p.v);
      left = std::min(left, u);
      right = std::max(right, u);
    }
    left = std::max(left, 0.0);
    right = std::min(right, buffer->width - 1.0);
    if (left > right) {
      continue;
    }
    const int first = static_cast<int>(std::ceil(left));
    const int last = static_cast<int>(std::floor(right));
    if (first > last) {
      continue;
    }
    const double at_zero = a.inverse_z - gu * a.u + gv * (y - a.v);
    float* row = buffer->depth.data() + static_cast<size_t>(y) * buffer->width;
    // Slivers seen edge-on: the plane's slope is too steep for the pixel grid, rounding could leave
    // the triangle.
    if (std::min(at_zero + gu * first, at_zero + gu * last) < 0.5 * far_inverse) {
      FillSpan(row, first, last, static_cast<float>(far_inverse), 0.0f);
    } else {
      FillSpan(row, first, last, static_cast<float>(at_zero), static_cast<float>(gu));
    }
  }
}

// Sutherland-Hodgman against the near plane; at most four corners.
int ClipNear(const std::array<Eigen::Vector3d, 3>& in, std::array<Eigen::Vector3d, 4>* out) {
  int count = 0;
  for (int k = 0; k < 3; ++k) {
    const Eigen::Vector3d& p = in[k];
    const Eigen::Vector3d& q = in[(k + 1) % 3];
    if (p.z() >= kNearM) {
      (*out)[count++] = p;
    }
    if ((p.z() >= kNearM) != (q.z() >= kNearM)) {
      (*out)[count++] = p + (q - p) * ((kNearM - p.z()) / (q.z() - p.z()));
    }
  }
  return count;
}

}  // namespace

DepthBuffer MakeDepthBuffer(int width, int height) {
  DepthBuffer buffer;
  buffer.width = std::max(width, 0);
  buffer.height = std::max(height, 0);
  buffer.depth.assign(static_cast<size_t>(buffer.width) * buffer.height, DepthBuffer::kNoDepth);
  return buffer;
}

void ClearDepth(DepthBuffer* buffer) {
  std::fill(buffer->depth.begin(), buffer->depth.end(), DepthBuffer::kNoDepth);
}

void RenderDepth(const TriangleMesh& mesh,
                 const PinholeCamera& camera,
                 const Rigid3& camera_from_object,
                 DepthBuffer* buffer) {
  if (buffer->depth.empty()) {
    return;
  }
  const int vertex_count = static_cast<int>(mesh.vertices.size());
  std::vector<Eigen::Vector3d> in_camera(mesh.vertices.size());
  std::vector<ScreenPoint> screen(mesh.vertices.size());
  for (int i = 0; i < vertex_count; ++i) {
    in_camera[i] = camera_from_object * mesh.vertices[i];
    if (in_camera[i].z() >= kNearM) {
      screen[i] = ToScreen(camera, in_camera[i]);
    }
  }
  for (const Eigen::Vector3i& t : mesh.triangles) {
    if (t.minCoeff() < 0 || t.maxCoeff() >= vertex_count) {
      continue;
    }
    const std::array<Eigen::Vector3d, 3> corners = {
        in_camera[t[0]], in_camera[t[1]], in_camera[t[2]]};
    if (!(corners[0] + corners[1] + corners[2]).allFinite()) {
      continue;
    }
    const double nearest = std::min({corners[0].z(), corners[1].z(), corners[2].z()});
    if (nearest >= kNearM) {
      FillTriangle(screen[t[0]], screen[t[1]], screen[t[2]], buffer);
      continue;
    }
    std::array<Eigen::Vector3d, 4> clipped;
    const int count = ClipNear(corners, &clipped);
    for (int k = 1; k + 1 < count; ++k) {
      FillTriangle(ToScreen(camera, clipped[0]),
                   ToScreen(camera, clipped[k]),
                   ToScreen(camera, clipped[k + 1]),
                   buffer);
    }
  }
}

bool IsVisible(const DepthBuffer& buffer,
               const Eigen::Vector2d& pixel,
               double z,
               double tolerance_m) {
  if (!(pixel.x() >= -0.5 && pixel.y() >= -0.5 && pixel.x() <= buffer.width - 0.5 &&
        pixel.y() <= buffer.height - 0.5)) {
    return false;
  }
  const int x = std::clamp(static_cast<int>(std::lround(pixel.x())), 0, buffer.width - 1);
  const int y = std::clamp(static_cast<int>(std::lround(pixel.y())), 0, buffer.height - 1);
  float farthest = 0.0f;
  for (int v = std::max(y - 1, 0); v <= std::min(y + 1, buffer.height - 1); ++v) {
    for (int u = std::max(x - 1, 0); u <= std::min(x + 1, buffer.width - 1); ++u) {
      farthest = std::max(farthest, buffer.At(u, v));
    }
  }
  return z <= farthest + tolerance_m;
}

}  // namespace horopter
