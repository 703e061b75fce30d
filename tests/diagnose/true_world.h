// The truth of a scene in one world: where the cameras stand when scene_camera.json does not say,
// and which entries of the images' lists are the same part.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/bop_dataset.h"
#include "tests/diagnose/ground_truth.h"

namespace horopter {

struct TrueWorld {
  // instances[i] is the same part in every image. Where an image's file does not list it its pose
  // follows from the world, else it is behind the camera; visib_fract is 0. has_pose says whether
  // camera_from_world is known, from the file or by way of the parts.
  BopScene scene;
  // How far the parts' poses agree with each other: rms over corners of their boxes and images,
  // pixels. Empty: the file gives all poses, or no image sees two parts that others see.
  std::optional<double> rms_px;
  std::vector<std::string> notes;  // images without a pose, parts that move against the others
};

// Cameras without cam_R_w2c follow from parts seen in several images: first from those without
// symmetries, of many images and large; then all parts speak, robustly. Images that share no part
// with the others keep has_pose = false. Parts of one obj_id are told apart by the order of their
// lists where these are of one length, else by where they are. Distortion beyond k1 is ignored.
TrueWorld CompleteTruth(const BopScene& scene, const TrueModels& models);

// Images whose camera is known in the world.
int PosedImages(const BopScene& scene);

}  // namespace horopter
