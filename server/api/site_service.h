#pragma once

#include "api/access.h"
#include "pipeline/sites.h"
#include "soundmap/v1/site_service.grpc.pb.h"

namespace soundmap::api {

class SiteService : public v1::SiteService::CallbackService {
 public:
  SiteService(pipeline::Sites* sites, Access* access) : sites_(sites), access_(access) {}

  grpc::ServerUnaryReactor* CreateSite(grpc::CallbackServerContext* context,
                                       const v1::CreateSiteRequest* request,
                                       v1::Site* response) override;
  grpc::ServerUnaryReactor* GetSite(grpc::CallbackServerContext* context,
                                    const v1::GetSiteRequest* request, v1::Site* response) override;
  grpc::ServerUnaryReactor* ListSites(grpc::CallbackServerContext* context,
                                      const v1::ListSitesRequest* request,
                                      v1::ListSitesResponse* response) override;
  grpc::ServerUnaryReactor* UpdateSite(grpc::CallbackServerContext* context,
                                       const v1::UpdateSiteRequest* request,
                                       v1::Site* response) override;
  grpc::ServerUnaryReactor* DeleteSite(grpc::CallbackServerContext* context,
                                       const v1::DeleteSiteRequest* request,
                                       v1::DeleteSiteResponse* response) override;

 private:
  pipeline::Sites* const sites_;
  Access* const access_;
};

}  // namespace soundmap::api
