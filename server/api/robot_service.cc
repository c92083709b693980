#include "api/robot_service.h"

#include <map>
#include <utility>

#include "absl/strings/str_cat.h"
#include "api/convert.h"
#include "api/find.h"
#include "api/paging.h"
#include "api/reactors.h"

namespace soundmap::api {
namespace {

// Every robot once, where it is live or was last seen at the sites of the grant, by name.
std::vector<pipeline::RobotInfo> AllRobots(const pipeline::Sites& sites, const Grant& grant) {
  std::map<std::string, pipeline::RobotInfo> newest;
  for (const auto& site : sites.List()) {
    if (!grant.Reaches(site->record().site)) continue;
    for (pipeline::RobotInfo& robot : site->Robots()) {
      pipeline::RobotInfo& known = newest[robot.robot];
      const auto order = [](const pipeline::RobotInfo& info) {
        return std::pair(info.live.has_value(), info.last_seen_ns);
      };
      if (known.robot.empty() || order(robot) > order(known)) known = std::move(robot);
    }
  }
  std::vector<pipeline::RobotInfo> robots;
  robots.reserve(newest.size());
  for (auto& [name, robot] : newest) robots.push_back(std::move(robot));
  return robots;
}

}  // namespace

grpc::ServerUnaryReactor* RobotService::GetRobot(grpc::CallbackServerContext* context,
                                                 const v1::GetRobotRequest* request,
                                                 v1::Robot* response) {
  const auto caller = access_->CallerOf(*context);
  if (!caller.ok()) return Finish(context, caller.status());
  const auto name = ParseRobot(request->name());
  if (!name.ok()) return Finish(context, name.status());
  for (const pipeline::RobotInfo& robot : AllRobots(*sites_, caller->grant)) {
    if (robot.robot != *name) continue;
    *response = ToProto(robot);
    return Finish(context, absl::OkStatus());
  }
  return Finish(context,
                absl::NotFoundError(absl::StrCat("robot '", *name, "' has not been here")));
}

grpc::ServerUnaryReactor* RobotService::ListRobots(grpc::CallbackServerContext* context,
                                                   const v1::ListRobotsRequest* request,
                                                   v1::ListRobotsResponse* response) {
  std::vector<pipeline::RobotInfo> robots;
  if (request->site().empty()) {
    const auto caller = access_->CallerOf(*context);
    if (!caller.ok()) return Finish(context, caller.status());
    robots = AllRobots(*sites_, caller->grant);
  } else {
    const auto site = FindSite(*sites_, request->site(), {access_, context, Right::kRead});
    if (!site.ok()) return Finish(context, site.status());
    robots = (*site)->Robots();
  }
  const auto page = PageOf(robots.size(), request->page_size(), request->page_token());
  if (!page.ok()) return Finish(context, page.status());
  for (std::size_t i = page->begin; i < page->end; ++i) {
    *response->add_robots() = ToProto(robots[i]);
  }
  response->set_next_page_token(page->next_token);
  return Finish(context, absl::OkStatus());
}

}  // namespace soundmap::api
