// Command lines of `load`, `status` and what describes the program itself.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "client/camera_hints.h"
#include "client/cli.h"
#include "client/commands.h"
#include "client/load/load_command.h"

namespace horopter {
namespace {

void AddLoadLoops(CLI::App* load, LoadArguments& a) {
  load->add_option("--concurrency", a.load.concurrency, "closed loop: requests at a time")
      ->capture_default_str()
      ->check(CLI::Range(1, 10000));
  load->add_option("--rate",
                   a.rates,
                   "open loop: requests a second, sent when they are due whatever the server does; "
                   "several, e.g. 1,2,4: one step after the other")
      ->delimiter(',')
      ->check(CLI::PositiveNumber);
  load->add_flag("--poisson", a.load.poisson, "independent arrivals (default: evenly spaced)");
  load->add_option("--ramp-to", a.load.rate_end_hz, "the rate grows linearly to this")
      ->check(CLI::PositiveNumber);
  load->add_option("--bound-ms",
                   a.bound_ms,
                   "looks for the highest rate with latency below this and no refusal, from the "
                   "first to the last --rate")
      ->check(CLI::PositiveNumber);
  load->add_option("--bound-percentile", a.bound_percentile, "of latency, for --bound-ms")
      ->capture_default_str()
      ->check(CLI::Range(1.0, 100.0));
  load->add_option("--duration", a.load.duration_s, "seconds a step (default: 10)")
      ->check(CLI::PositiveNumber);
  load->add_option("--requests", a.load.requests, "a step ends after so many")
      ->check(CLI::PositiveNumber);
  load->add_option("--warmup", a.load.warmup, "requests before the first that counts")
      ->capture_default_str()
      ->check(CLI::NonNegativeNumber);
  load->add_option("--seed", a.load.seed, "of arrivals and order: the same seed, the same run")
      ->capture_default_str();
}

void AddLoad(CLI::App& app, Command* command) {
  auto a = std::make_shared<LoadArguments>();
  a->load.duration_s = 10.0;
  CLI::App* load = AddCommand(
      app,
      "load",
      "measure latency, throughput and accuracy under load",
      "horopter load parts/val/000005 --requests 3 --csv load.csv\n"
      "  horopter load parts/val --rate 2,4 --poisson --duration 1 --svg load.svg --json");
  load->add_option("SOURCE",
                   a->sources,
                   "scenes or splits of datasets in BOP layout, folders of images of one scene, "
                   "recordings of horopterd --record-dir or a folder of them")
      ->required();
  AddLoadLoops(load, *a);
  load->add_option("--max-images", a->items.max_images, "per set, spread evenly (default: all)")
      ->check(CLI::PositiveNumber);
  load->add_option("--hints", a->items.hints, "as of dataset recognize: none, focal, truth")
      ->transform(CLI::CheckedTransformer(kHints));
  load->add_option("--candidates", a->candidates, "ids to look for (default: all)")->delimiter(',');
  load->add_option("--json-file", a->json_path, "all figures as JSON");
  load->add_option("--csv", a->csv_path, "one line a request");
  load->add_option("--svg", a->svg_path, "latency against rate; of one rate, against percentile");
  load->callback([=] {
    // A number of requests alone bounds the run.
    if (a->load.requests > 0 && load->count("--duration") == 0 && a->load.rate_end_hz == 0.0) {
      a->load.duration_s = 0.0;
    }
    *command = [a](HoropterClient& c) { return Load(c, *a); };
  });
}

}  // namespace

void AddToolCommands(CLI::App& app, Command* command) {
  AddLoad(app, command);
  AddCommand(app,
             "status",
             "whether the server takes calls; its version, load, limits and catalog",
             "horopter status --json")
      ->callback([=] { *command = ServerStatus; });
  auto files = std::make_shared<std::vector<std::string>>();
  CLI::App* replay = AddCommand(app,
                                "replay",
                                "send recorded requests again and compare the answers",
                                "horopter replay recordings/*.horec");
  replay->add_option("FILE", *files, "of horopterd --record-dir")->required();
  replay->callback([=] { *command = [files](HoropterClient& c) { return Replay(c, *files); }; });
  CLI::App* root = &app;
  AddCommand(app,
             "completion",
             "print a script that completes commands in bash",
             "horopter completion > horopter.bash")
      ->callback([=] {
        *command = [root](HoropterClient&) {
          std::printf("%s", BashCompletion(*root).c_str());
          return absl::OkStatus();
        };
      });
  AddCommand(app, "manual", "print the manual page", "horopter manual > horopter.1")->callback([=] {
    *command = [root](HoropterClient&) {
      std::printf("%s", ManPage(*root).c_str());
      return absl::OkStatus();
    };
  });
}

}  // namespace horopter
