#include "client/expected_file.h"

#include <google/protobuf/util/json_util.h>

#include <cmath>
#include <map>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "client/commands.h"
#include "client/convert.h"
#include "server/base/status_macros.h"

namespace horopter {
namespace {

// "missing" of STATE_MISSING.
std::string NameOf(v1::ExpectedOutcome::State state) {
  std::string name = v1::ExpectedOutcome::State_Name(state);
  if (name.empty()) return "unknown";
  name = absl::AsciiStrToLower(name.substr(sizeof("STATE_") - 1));
  for (char& c : name) c = c == '_' ? ' ' : c;
  return name;
}

double ProbabilityOf(const v1::ExpectedOutcome& o) {
  switch (o.state()) {
    case v1::ExpectedOutcome::STATE_PRESENT:
      return o.present_probability();
    case v1::ExpectedOutcome::STATE_MISSING:
      return o.missing_probability();
    case v1::ExpectedOutcome::STATE_DISPLACED:
      return o.displaced_probability();
    case v1::ExpectedOutcome::STATE_WRONG_PART:
      return o.wrong_part_probability();
    default:
      return o.cannot_tell_probability();
  }
}

absl::Status AddExpectedFile(const std::string& path, v1::RecognizeSceneRequest* request) {
  HOROPTER_ASSIGN_OR_RETURN(const std::string text, ReadFileBytes(path));
  v1::RecognizeSceneRequest file;
  const auto read = google::protobuf::util::JsonStringToMessage(text, &file);
  if (!read.ok()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", std::string(read.message().data(), read.message().size())));
  }
  for (v1::ExpectedPart& part : *file.mutable_expected_parts()) {
    part.set_object(ResourceName(IdOfResource(part.object())));
    if (!part.frame_object().empty())
      part.set_frame_object(ResourceName(IdOfResource(part.frame_object())));
    *request->add_expected_parts() = part;
  }
  file.clear_expected_parts();
  if (file.ByteSizeLong() > 0)
    return absl::InvalidArgumentError(absl::StrCat(path, ": holds more than expected_parts"));
  if (request->expected_parts().empty())
    return absl::InvalidArgumentError(absl::StrCat(path, ": holds no expected_parts"));
  return absl::OkStatus();
}

}  // namespace

absl::Status AddExpectedParts(const std::vector<std::string>& words,
                              v1::RecognizeSceneRequest* request) {
  for (const std::string& word : words) {
    if (absl::EndsWithIgnoreCase(word, ".json")) {
      HOROPTER_RETURN_IF_ERROR(AddExpectedFile(word, request));
      continue;
    }
    v1::ExpectedPart* part = request->add_expected_parts();
    const size_t equals = word.find('=');
    int count = 1;
    if (equals != std::string::npos &&
        (!absl::SimpleAtoi(word.substr(equals + 1), &count) || count < 1)) {
      return absl::InvalidArgumentError(
          absl::StrCat("--expect ", word, ": takes ID, ID=COUNT or FILE.json"));
    }
    part->set_object(ResourceName(word.substr(0, equals)));
    part->set_count(count);
  }
  return absl::OkStatus();
}

std::string ExpectedText(const v1::ExpectedReport& report,
                         const v1::RecognizeSceneRequest& request) {
  std::string text;
  for (const v1::ExpectedOutcome& o : report.outcomes()) {
    const int i = o.expected_index();
    const std::string id = i >= 0 && i < request.expected_parts_size()
                               ? IdOfResource(request.expected_parts(i).object())
                               : "?";
    absl::StrAppendFormat(&text,
                          "expected %s%s: %s (%.2f)%s%s\n",
                          id,
                          o.label().empty() ? "" : absl::StrCat(", ", o.label()),
                          NameOf(o.state()),
                          ProbabilityOf(o),
                          o.detail().empty() ? "" : "; ",
                          o.detail());
  }
  for (const v1::UnexpectedObject& u : report.unexpected())
    absl::StrAppendFormat(
        &text, "not expected: %s (instance %d)\n", IdOfResource(u.object()), u.instance());
  absl::StrAppendFormat(&text, "all present: %.2f\n", report.all_present_probability());
  return text;
}

absl::Status StatusOfExpected(const v1::ExpectedReport& report) {
  std::map<std::string, int> counts;
  int present = 0;
  for (const v1::ExpectedOutcome& o : report.outcomes()) {
    if (o.state() == v1::ExpectedOutcome::STATE_PRESENT) {
      ++present;
    } else {
      ++counts[NameOf(o.state())];
    }
  }
  if (counts.empty()) return absl::OkStatus();
  std::string text =
      absl::StrCat("of ", report.outcomes_size(), " expected parts ", present, " present");
  for (const auto& [name, count] : counts) absl::StrAppend(&text, ", ", count, " ", name);
  return absl::OutOfRangeError(text);
}

}  // namespace horopter
