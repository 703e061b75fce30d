// Photographs of textured surfaces by ray casting, with true cameras: what a reconstruction from
// texture is tried on, good input and bad. A scene of five images of 640 x 480 takes about a
// second.
#pragma once

#include <Eigen/Core>
#include <opencv2/core/mat.hpp>
#include <vector>

#include "server/vision/geometry/pinhole_camera.h"
#include "server/vision/geometry/rigid3.h"

namespace horopter {

// Textures are CV_32F, 0..255; beyond their border they repeat.
// Blobs of several sizes about grey 128 with the given standard deviation: no spot is like another.
cv::Mat BlobTexture(unsigned seed, double contrast = 40.0);
// Squares of `cell` texels, black and white by turns.
cv::Mat CheckerTexture(int cells, int cell);
// A board of cells x cells black squares with random bits inside, as fiducial markers are; with
// `alike` all have the same bits.
cv::Mat MarkerTexture(int cells, bool alike, unsigned seed);

// A rectangle in its body's frame: corner + a u + b v for a in [0, |u|], b in [0, |v|] metres along
// perpendicular u and v.
struct TexturedRectangle {
  Eigen::Vector3d corner = Eigen::Vector3d::Zero();
  Eigen::Vector3d u = Eigen::Vector3d::UnitX();  // its length is the rectangle's
  Eigen::Vector3d v = Eigen::Vector3d::UnitY();
  cv::Mat texture;
  double texel_m = 0.001;
  std::vector<cv::Mat> screen;  // a screen: what it shows in view k (instead of the texture)
  bool mirrors = false;         // reflects what is before it
};

// What moves as one.
using TexturedBody = std::vector<TexturedRectangle>;

// The five faces of a box on z = 0 that are seen, each with a texture of its own.
TexturedBody TexturedBox(const Eigen::Vector3d& centre_on_plane,
                         const Eigen::Vector3d& size_m,
                         double turn_rad,
                         unsigned seed);

struct TexturedView {
  PinholeCamera camera;
  Rigid3 camera_from_world;             // of the image's middle row
  std::vector<Rigid3> world_from_body;  // empty: the bodies stand in the world
  // Rotation vector and translation (camera frame) from the first row to the last: rolling shutter.
  Eigen::Vector3d row_turn_rad = Eigen::Vector3d::Zero();
  Eigen::Vector3d row_move_m = Eigen::Vector3d::Zero();
  bool mirrored = false;  // the image is flipped left to right, as some programs save it
};

struct TexturedScene {
  std::vector<TexturedBody> bodies;
  std::vector<TexturedView> views;
  double background = 105.0;  // grey of what hits nothing

  Rigid3 CameraFromBody(int view, int body) const;
};

struct TexturedSceneOptions {
  unsigned seed = 1;
  int views = 5;
  int boxes = 4;         // 0: the plane alone
  double arc_rad = 0.9;  // azimuth covered by the views
  double distance_m = 0.8;
  double focal_widths = 1.3;
  double zoom = 1.0;       // largest focal length over the smallest, by turns
  double contrast = 40.0;  // of the plane; boxes have 40
  int width = 640, height = 480;
};

// Body 0 is the plane z = 0, 1.6 m wide; the boxes on it are body 1. The world's z points up.
TexturedScene MakeTexturedScene(const TexturedSceneOptions& options);

// CV_8UC3 (grey in colour), two by two rays a pixel, noise of `noise` grey levels.
cv::Mat RenderTextured(const TexturedScene& scene, int view, double noise = 1.5);
std::vector<cv::Mat> RenderTextured(const TexturedScene& scene, double noise = 1.5);

// Bad input. The views' true poses are those of the bodies, see CameraFromBody.
// Each view looks at a place of its own.
TexturedScene WithoutOverlap(unsigned seed, int views);
// The camera stands; boxes on a disc (body 1) turn before a textured floor and wall (body 0).
TexturedScene OnTurntable(unsigned seed, int views);
// The camera stands; boxes (body 1) move along on a textured belt (also body 1), before a wall.
TexturedScene OnConveyor(unsigned seed, int views);
// All cameras in one place.
TexturedScene TurnedOnly(unsigned seed, int views);
// A plane of checks, or of markers that are all alike, under plain boxes.
TexturedScene OnRepeats(unsigned seed, int views, const cv::Mat& texture, double texel_m);
// A plain plane with two boxes, a screen that shows something else in each view, and a mirror.
TexturedScene WithScreenAndMirror(unsigned seed, int views);

}  // namespace horopter
