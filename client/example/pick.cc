// pick SERVER IMAGE...: prints the best grasp of every part in the images.
#include <cstdio>
#include <fstream>
#include <iterator>
#include <string>

#include "client/api.h"
#include "client/convert.h"

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr, "usage: pick HOST:PORT IMAGE...\n");
    return 2;
  }
  horopter::HoropterClient client(argv[1], 60.0);
  horopter::v1::RecognizeSceneRequest request;
  for (int i = 2; i < argc; ++i) {
    std::ifstream file(argv[i], std::ios::binary);
    request.add_images()->mutable_content()->assign(std::istreambuf_iterator<char>(file), {});
  }
  const auto answer = client.RecognizeScene(request);
  if (!answer.ok()) {
    std::fprintf(stderr, "%s\n", answer.status().ToString().c_str());
    return 1;
  }
  for (const auto& part : answer->objects()) {
    const std::string id = horopter::IdOfResource(part.object());
    if (part.grasps_size() == 0) {
      std::printf("%s %.2f: no grasp\n", id.c_str(), part.score());
      continue;
    }
    const horopter::Rigid3 gripper = horopter::FromProto(part.grasps(0).scene_from_gripper());
    std::printf("%s %.2f: %s at %.4f %.4f %.4f m\n",
                id.c_str(),
                part.score(),
                part.grasps(0).name().c_str(),
                gripper.t.x(),
                gripper.t.y(),
                gripper.t.z());
  }
  return 0;
}
